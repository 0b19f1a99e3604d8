from collections.abc import Callable, Iterator, Mapping, Sequence
from os import PathLike
from typing import Any, TypedDict, final

import numpy as np
from numpy.typing import NDArray

__version__: str
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

#: A recipe: the path of a TOML file, or its tables as a mapping.
Recipe = str | PathLike[str] | Mapping[str, Any]

class FacileError(Exception):
    """What can go wrong in Facile."""

class RecipeError(FacileError):
    """A recipe is wrong; the message shows the line."""

class CoreError(FacileError):
    """A mesh, texture or name is bad."""

class FlowError(FacileError):
    """A scan cannot be registered."""

class SimError(FacileError):
    """A face finds no equilibrium, or cannot be asked for it."""

class TraceError(FacileError):
    """A scene cannot be rendered."""

class PipelineError(FacileError):
    """A dataset cannot be read or written."""

class _Required(TypedDict):
    image: NDArray[np.uint8]
    record: dict[str, Any]

class Sample(_Required, total=False):
    """An image with its record and the maps that the recipe asks for.

    ``image`` is ``(h, w, 3)`` sRGB. ``segments``, ``visibility`` and ``occlusion`` are ``(h, w)``; ``depth_mm`` is
    ``(h, w)``, infinite where nothing is; ``amodal`` and ``coverage`` are ``(h, w)``; ``layers`` and ``layer_depth_mm`` are
    ``(4, h, w)``, the nearest surface first; ``normals`` is ``(h, w, 3)`` in the camera's axes, zero where nothing is.
    ``instances`` is ``(h, w)``, the number of the occluder's body that is seen; ``reference`` is ``(h, w, 2)``, ``h`` in
    mm and ``phi`` in rad of the reference head's point under the skin, not a number elsewhere; ``albedo`` is
    ``(h, w, 3)``, linear, 0 where nothing is; ``shadow`` is ``(h, w)``, 255 where all directed light arrives.
    """

    segments: NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    visibility: NDArray[np.uint8]
    occlusion: NDArray[np.uint8]
    amodal: NDArray[np.uint8]
    coverage: NDArray[np.uint8]
    layers: NDArray[np.uint8]
    layer_depth_mm: NDArray[np.float32]
    instances: NDArray[np.uint8]
    reference: NDArray[np.float32]
    albedo: NDArray[np.float32]
    shadow: NDArray[np.uint8]

@final
class Dataset:
    """The samples of a recipe, made on demand and without files.

    Sample ``i`` is the same as image ``i`` of :func:`generate`. Reading in order is fastest, since neighbours share
    registration, equilibrium and primary rays. Pickles as its recipe.
    """

    def __new__(cls, recipe: Recipe) -> Dataset: ...
    def __len__(self) -> int: ...
    def __getitem__(self, index: int, /) -> Sample: ...
    def __iter__(self) -> Iterator[Sample]: ...
    @property
    def name(self) -> str:
        """The recipe's name."""
    @property
    def recipe_hash(self) -> str:
        """Hash of everything the samples depend on."""

@final
class Face:
    """A subject in a pose."""

    @property
    def vertices(self) -> NDArray[np.float64]:
        """``(n, 3)`` positions, mm, head frame."""
    @property
    def faces(self) -> NDArray[np.uint32]:
        """``(m, 3)`` vertex indices, counter-clockwise from outside."""
    @property
    def certificate(self) -> dict[str, Any]:
        """How well the equilibrium is met."""
    def landmarks(self, scheme: str = "ibug68") -> NDArray[np.float64]:
        """``(k, 3)`` landmarks of a scheme, mm."""
    def save(self, path: str | PathLike[str]) -> None:
        """Writes the face as GLB."""

@final
class Subject:
    """A person: own shape and texture on the reference topology, at rest."""

    @staticmethod
    def load(path: str | PathLike[str], *, texture: str | PathLike[str] | None = None) -> Subject:
        """Registers a scan (OBJ, PLY, GLB). ``texture`` replaces the one the file names."""
    @staticmethod
    def builtin(name: str) -> Subject:
        """A subject that ships with the program; see :meth:`builtin_names`."""
    @staticmethod
    def builtin_names() -> list[str]:
        """Names of the subjects that ship with the program."""
    @staticmethod
    def sample(number: int, *, seed: int = 0) -> Subject:
        """Identity ``number`` of the family ``seed`` of the identity model."""
    @property
    def id(self) -> str:
        """Name in records."""
    @property
    def attributes(self) -> dict[str, str]:
        """What is known of the person."""
    @property
    def vertices(self) -> NDArray[np.float64]:
        """``(n, 3)`` positions, mm, head frame."""
    @property
    def faces(self) -> NDArray[np.uint32]:
        """``(m, 3)`` vertex indices, counter-clockwise from outside."""
    @property
    def texture(self) -> NDArray[np.uint8]:
        """``(h, w, 3)`` sRGB in the reference UV, top row first."""
    @property
    def notices(self) -> list[str]:
        """What the user should know of how the scan was read."""
    def pose(
        self,
        *,
        expression: str | None = None,
        intensity: float = 1.0,
        muscles: Mapping[str, float] | None = None,
        action_units: Mapping[str, float] | None = None,
        jaw_deg: float | None = None,
        gaze_deg: tuple[float, float] | None = None,
    ) -> Face:
        """The face at rest under these contractions.

        ``muscles`` maps names, of one side with ``.left`` or ``.right``, to contractions in ``[0, 1]``;
        ``action_units`` maps FACS units to intensities in ``[0, 1]``. Alone, ``expression`` names a built-in one.
        """
    def save(self, path: str | PathLike[str]) -> None:
        """Writes the subject as GLB."""

def generate(
    recipe: Recipe,
    *,
    output: str | PathLike[str] | None = None,
    jobs: int | None = None,
    limit: int | None = None,
    shard: str | None = None,
    overwrite: bool = False,
    max_failures: int | None = None,
    report: str | PathLike[str] | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Generates a dataset, or what is missing of it.

    ``shard="I/N"`` makes only part ``I`` of ``N`` in a folder of its own; :func:`merge` puts parts together.
    Once more than ``max_failures`` samples have failed nothing more is begun. ``report`` names an HTML file for times,
    caches, failures, histograms and pictures. ``progress`` is called with the samples done and their number, a few times a second. Ctrl-C finishes the samples in
    hand and raises ``KeyboardInterrupt``; the next call goes on from there. Returns the counts ``samples``, ``kept``,
    ``made``, the ``output`` folder, the list of ``failures``, and ``effort``: where the time went.
    """

def merge(
    parts: Sequence[str | PathLike[str]], output: str | PathLike[str], *, overwrite: bool = False
) -> dict[str, Any]:
    """Puts parts of a dataset together: the bytes of one run. Returns the manifest; ``complete`` says if all is there."""

def verify(dataset: str | PathLike[str]) -> dict[str, Any]:
    """Checks every file against its hash. Returns ``files``, their number, the list ``bad`` and the ``manifest``."""

def render(
    subject: Subject,
    *,
    expression: Mapping[str, Any] | None = None,
    light: Mapping[str, Any] | None = None,
    view: Mapping[str, Any] | None = None,
    occluder: Mapping[str, Any] | None = None,
    image: Mapping[str, Any] | None = None,
    hair: Mapping[str, Any] | None = None,
    clothes: Mapping[str, Any] | None = None,
    background: Mapping[str, Any] | None = None,
    sensor: Mapping[str, Any] | None = None,
) -> Sample:
    """Renders one image of a subject. Each mapping has the keys of the recipe's table of that name.

    The subject wears hair and a shirt if ``hair`` and ``clothes`` are given, and shows what is painted on its skin if not.
    """

def render_scene(path: str | PathLike[str], output: str | PathLike[str]) -> dict[str, Any]:
    """Renders a scene file into the folder ``output``: any meshes, one camera, any lights. Returns the timings, ms."""

def schema() -> dict[str, Any]:
    """The JSON Schema of the recipe."""
