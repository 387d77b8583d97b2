"""Posts and lines in the image they were seen in. Pixel centres are at integers, as everywhere in fieldloc."""

from foxglove.messages import (
    CircleAnnotation,
    Color,
    ImageAnnotations,
    Point2,
    PointsAnnotation,
    PointsAnnotationType,
    TextAnnotation,
)

from fieldloc.measurements import ImageFeatures, PostObservation
from fieldloc.pose import FloatArray
from logs.foxglove.shapes import BLUE, RED, WHITE, YELLOW, timestamp

_STROKE_PX, _FOOT_PX, _FONT_PX = 2.0, 8.0, 12.0
_BEHIND_TEXT = Color(r=0.0, g=0.0, b=0.0, a=0.5)


def image_annotations(image: ImageFeatures) -> ImageAnnotations:
    """Lines in yellow; of each post a blue line between its edges, a red circle at its foot, and its name."""
    time = timestamp(image.stamp_ns)

    def drawn(ends_px: FloatArray, colour: Color) -> PointsAnnotation:
        return PointsAnnotation(
            timestamp=time,
            type=PointsAnnotationType.LineList,
            points=[Point2(x=u, y=v) for u, v in ends_px.tolist()],
            outline_color=colour,
            thickness=_STROKE_PX,
        )

    def foot(u: float, v: float) -> CircleAnnotation:
        return CircleAnnotation(
            timestamp=time,
            position=Point2(x=u, y=v),
            diameter=_FOOT_PX,
            thickness=_STROKE_PX,
            outline_color=RED,
        )

    def name(post: PostObservation, label: str) -> TextAnnotation:
        u, v = post.edges_px[1].tolist()
        return TextAnnotation(
            timestamp=time,
            position=Point2(x=u, y=v),
            text=label,
            font_size=_FONT_PX,
            text_color=WHITE,
            background_color=_BEHIND_TEXT,
        )

    return ImageAnnotations(
        timestamp=time,
        circles=[foot(*post.foot_px.tolist()) for post in image.posts if post.foot_px is not None],
        points=[
            *(drawn(post.edges_px, BLUE) for post in image.posts),
            *(drawn(line.ends_px, YELLOW) for line in image.lines),
        ],
        texts=[name(post, post.label) for post in image.posts if post.label is not None],
    )
