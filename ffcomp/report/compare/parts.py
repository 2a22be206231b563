"""Errors by layer and by feature where plastic flows: the same quantity as that of the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffcomp.compare.evaluation import contour_numbers
from ffcomp.compare.result import Comparison, Error, Method
from ffcomp.report.compare.words import extrudes
from models.arrays import IntArray


def by_layer(found: Comparison, method: Method) -> dict[int, Error]:
    """Return the error on each layer's number."""
    return _by(found, method, method.samples.layer)


def by_feature(found: Comparison, method: Method) -> dict[str, Error]:
    """Return the error on each feature's name; its share is that of the time that is counted."""
    return {found.features[k]: error for k, error in _by(found, method, method.samples.feature).items()}


def _by(found: Comparison, method: Method, labels: IntArray) -> dict[int, Error]:
    s = method.samples
    seen = s.extruding if extrudes(found) else np.ones(len(labels), dtype=np.bool_)
    errors = {int(k): contour_numbers(s, seen & (labels == k)) for k in np.unique(labels[seen])}
    total = max(sum(each.share for each in errors.values()), 1e-12)
    return {k: replace(each, share=each.share / total) for k, each in errors.items()}
