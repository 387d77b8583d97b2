"""What an estimator says of its hypotheses, and of what befell them, as JSON."""

from typing import get_args

from estimators.base import Ambiguity, Event, EventKind, Hypothesis
from logs.messages.fields import (
    STAMP,
    BadField,
    JsonObject,
    covariance,
    integer,
    list_of,
    many,
    number,
    numeric,
    object_schema,
    stamp,
    string,
    text,
)
from logs.messages.motion import POSE, POSE_COVARIANCE, pose_from_json, pose_to_json

_KINDS: dict[str, EventKind] = {kind: kind for kind in get_args(EventKind)}
_ROUNDING = 1e-6  # by which a sum of probabilities may be beyond 1

AMBIGUITY_SCHEMA = object_schema(
    "Where the robot may be, by an estimator that keeps several hypotheses",
    stamp_ns=STAMP,
    mirrored=numeric("Probability that it is where the map's symmetries take the first hypothesis to"),
    lost=numeric("Probability that it is at none of the hypotheses"),
    hypotheses=list_of(
        object_schema(
            "One of the poses that the robot may have",
            weight=numeric("Its probability"),
            **POSE,
            covariance=POSE_COVARIANCE,
            track={"type": "integer", "description": "The same for the same hypothesis in all messages"},
        ),
        "The likeliest first; of many the likeliest only, so that the weights and lost may add up to less than 1",
    ),
)
EVENT_SCHEMA = object_schema(
    "Something that befell the hypotheses",
    stamp_ns=STAMP,
    kind=string(f"One of {', '.join(_KINDS)}"),
    text=string("A sentence for people"),
)


def ambiguity_to_json(record: Ambiguity) -> JsonObject:
    return {
        "stamp_ns": int(record.stamp_ns),
        "mirrored": float(record.mirrored),
        "lost": float(record.lost),
        "hypotheses": [
            {
                "weight": float(one.weight),
                **pose_to_json(one.pose),
                "covariance": one.covariance.tolist(),
                "track": int(one.track),
            }
            for one in record.hypotheses
        ],
    }


def ambiguity_from_json(data: JsonObject) -> Ambiguity:
    hypotheses = tuple(many(data, "hypotheses", _hypothesis_from_json))
    return Ambiguity(stamp(data), hypotheses, _probability(data, "mirrored"), _probability(data, "lost"))


def _hypothesis_from_json(data: JsonObject) -> Hypothesis:
    return Hypothesis(
        _probability(data, "weight"), pose_from_json(data), covariance(data, "covariance", 3), integer(data, "track")
    )


def event_to_json(record: Event) -> JsonObject:
    return {"stamp_ns": int(record.stamp_ns), "kind": str(record.kind), "text": str(record.text)}


def event_from_json(data: JsonObject) -> Event:
    kind = text(data, "kind")
    if kind not in _KINDS:
        raise BadField("kind", f"is '{kind}', there is {', '.join(_KINDS)}")
    return Event(stamp(data), _KINDS[kind], text(data, "text"))


def _probability(data: JsonObject, name: str) -> float:
    value = number(data, name)
    if not -_ROUNDING <= value <= 1.0 + _ROUNDING:
        raise BadField(name, f"is {value:g}, must be from 0 to 1")
    return value
