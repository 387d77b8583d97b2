"""Analytic solvers: what one image says about the pose, each with its propagated covariance, all solutions, best first.

n posts or landmarks, m on the map. "labelled": it is known which is which.

| solver | needs | solutions | source |
|---|---|---|---|
| central_angle.central_angle_arcs | unsigned angle between two posts | 2 arcs | paper eqs. 1-2 |
| central_angle.two_post_triangle | unsigned angle, two sizes | sides, angles, gradients | paper eqs. 3-5, 7-10, 12 |
| central_angle.positions_from_angle | unsigned angle, two sizes | 2 positions, no heading | paper eqs. 6, 11 |
| two_posts.fix_two_posts | two labelled posts: bearings, size ratio | 1 | paper eqs. 3-12, complex numbers |
| two_posts.fix_two_alike_posts | the same, not labelled | 2 per pair of the map | same |
| cylinder.fix_two_posts_from_edges | four bearings of the edges of two labelled posts | 1 | exact cylinder |
| ranged_posts.fix_ranged_posts | two labelled posts: bearings, sizes of known scale | 1 or 2 | maximum likelihood |
| ranged_posts.fix_alike_ranged_posts | the same, not labelled | all | same |
| one_post.arc_of_one_post | one post: bearing, size of known scale | 1 arc of poses | paper eq. 3 |
| post_feet.sight_posts | posts' feet or widths, camera's place | joint bearings, distances | paper eqs. 14-15 |
| post_feet.fix_two_posts_of_image | the same, two labelled posts | 1 or 2 | same, then ranged_posts |
| landmarks.landmark_fix | n >= 2 labelled: ranges, bearings | 0 to 2 | rigid alignment, Gauss-Newton; Krotkov 1989 |
| labelling.label_landmarks | n >= 2 not labelled: ranges, bearings | all | Sugihara 1988 |
| resection.resection_fix | n >= 3 labelled: bearings only | 1 | three-point resection; Krotkov 1989 |
| labelling_bearings.label_bearings | n >= 3 not labelled: bearings only | all, up to a bound | Sugihara 1988 |
| vanishing.bearing_of_vanishing_point | a vanishing point, attitude | 1, modulo 90 deg | paper eq. 13, general case |
| lines.lines_on_the_ground | n >= 1 line segments, camera's place | 1, modulo 90 deg | paper eqs. 13-15, one fit |
| line_solutions.line_solutions | lines of both directions, map | all, with weights; up to 64 | least squares |
| line_solutions.line_constraints | lines of one direction, map | all: heading and one coordinate | same |
"""
