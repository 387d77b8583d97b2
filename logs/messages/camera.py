"""A camera's intrinsics as JSON, in the words of the camera's TOML file."""

from typing import get_args

from fieldloc.camera import Camera
from fieldloc.lens import Model
from logs.messages.fields import (
    BadField,
    JsonObject,
    array,
    integer,
    list_of,
    number,
    numeric,
    object_schema,
    string,
    text,
)

_WHOLE: JsonObject = {"type": "integer", "minimum": 1, "description": "Size of the image"}
CAMERA_SCHEMA = object_schema(
    "Intrinsics of the camera, in force from this message on; pixel centres at integers",
    model=string("pinhole or fisheye"),
    width_px=_WHOLE,
    height_px=_WHOLE,
    fx_px=numeric("Focal length along u"),
    fy_px=numeric("Focal length along v"),
    cx_px=numeric("Principal point, u"),
    cy_px=numeric("Principal point, v"),
    distortion=list_of({"type": "number"}, "Coefficients in OpenCV's order; empty: none"),
)


def camera_to_json(record: Camera) -> JsonObject:
    return {
        "model": record.model,
        "width_px": record.width_px,
        "height_px": record.height_px,
        "fx_px": float(record.fx_px),
        "fy_px": float(record.fy_px),
        "cx_px": float(record.cx_px),
        "cy_px": float(record.cy_px),
        "distortion": [float(x) for x in record.distortion],
    }


def camera_from_json(data: JsonObject) -> Camera:
    models: dict[str, Model] = {model: model for model in get_args(Model)}
    model = text(data, "model")
    if model not in models:
        raise BadField("model", f"is '{model}', must be one of: {', '.join(models)}")
    try:
        return Camera(
            model=models[model],
            width_px=integer(data, "width_px"),
            height_px=integer(data, "height_px"),
            fx_px=number(data, "fx_px"),
            fy_px=number(data, "fy_px"),
            cx_px=number(data, "cx_px"),
            cy_px=number(data, "cy_px"),
            distortion=tuple(array(data, "distortion").tolist()),
        )
    except BadField:
        raise
    except ValueError as error:  # what only the camera as a whole can tell, such as the number of coefficients
        raise BadField("the camera", f"is refused: {error}") from None
