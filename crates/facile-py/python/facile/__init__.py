"""Labelled face datasets from 3D scans: registration, muscle simulation, ray tracing.

>>> import facile
>>> dataset = facile.Dataset("dataset.toml")
>>> sample = dataset[0]
>>> sample["image"].shape
(256, 256, 3)

Lengths are millimetres, ``y`` is up, the face looks along ``+z`` and ``x`` points to the subject's left. Angles are in
degrees, as their names say.
"""

from ._facile import (
    CoreError,
    Dataset,
    Face,
    FacileError,
    FlowError,
    PipelineError,
    RecipeError,
    SimError,
    Subject,
    TraceError,
    __version__,
    generate,
    merge,
    render,
    render_scene,
    schema,
    verify,
)

__all__ = [
    "CoreError",
    "Dataset",
    "Face",
    "FacileError",
    "FlowError",
    "PipelineError",
    "RecipeError",
    "SimError",
    "Subject",
    "TraceError",
    "__version__",
    "generate",
    "merge",
    "render",
    "render_scene",
    "schema",
    "verify",
]
