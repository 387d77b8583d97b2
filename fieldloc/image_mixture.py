"""The posts and lines of an image as a mixture: all poses from which it can have been taken."""

from fieldloc.camera import Camera
from fieldloc.detection import Detection
from fieldloc.field import FieldMap
from fieldloc.measurements import ImageFeatures
from fieldloc.mixture import MixtureFactor


def image_mixture(
    features: ImageFeatures, camera: Camera, field: FieldMap, detection: Detection, wider: float
) -> MixtureFactor | None:
    """wider: by how much variances are to be widened, as the image shows much the same as the last one."""
    raise NotImplementedError
