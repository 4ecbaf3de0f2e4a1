"""What a comparison found: plain dataclasses, which `results.json` and the page of a report are written from."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.quality.figures import SCALES, Figure, Method

Image = NDArray[np.float32]
"""(H, W, 3) linear radiance, rows from the top."""


@dataclass(frozen=True)
class Scene:
    """A render that methods were compared in.

    Args:
        name: key, also of files: `sphere-near`, `plane`, ...
        title: what a reader is shown.
        view, scale: as in Figure.
        lod: median level of detail of the covered pixels.
        resolution: (height, width).
        lighting: its name.
        passes: samples for each pixel of the reference.
        standard_error: of the reference; candidate_error: of the best candidate; both root mean squares of radiance.
        converged: whether the first is at most the wanted share of the second.
    """

    name: str
    title: str
    view: str
    scale: str
    lod: float
    resolution: tuple[int, int]
    lighting: str
    passes: int
    standard_error: float
    candidate_error: float
    converged: bool


@dataclass(frozen=True, eq=False)
class Rendered:
    """The images of a scene.

    Args:
        scene: what they show.
        reference: the mean of the reference's halves.
        images: method name to candidate.
        interior: (H, W) bool, pixels that lie wholly on the mesh; figures are taken over these.
        flip: method name to (H, W) float32 FLIP error, 0 to 1, of the displayed images.
    """

    scene: Scene
    reference: Image
    images: Mapping[str, Image]
    interior: NDArray[np.bool_]
    flip: Mapping[str, NDArray[np.float32]]

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Rendered({self.scene.name!r}, {', '.join(self.images)})"


@dataclass(frozen=True)
class FilmedScene:
    """A film that methods were compared in.

    Args:
        name: key, also of files, and the view of its figures: `film-floor`, `film-low-floor`, ...
        title: what a reader is shown.
        motion: what moves, `camera` or `light`. sampler: how stacks were looked up.
        lod: median level of detail of the first frame's covered pixels.
        resolution: (height, width). frames: how many. frames_per_second: at which they are shown.
        lighting: its name. exposure: at which all frames are displayed.
        passes: samples for each pixel of the reference.
        noise: of the reference; candidate_error: of the closest candidate; both root mean squares of displayed values.
        converged: whether the first is at most the wanted share of the second.
    """

    name: str
    title: str
    motion: str
    sampler: str
    lod: float
    resolution: tuple[int, int]
    frames: int
    frames_per_second: float
    lighting: str
    exposure: float
    passes: int
    noise: float
    candidate_error: float
    converged: bool


@dataclass(frozen=True, eq=False)
class Filmed:
    """The frames of a film.

    Args:
        scene: what they show.
        reference: (T, H, W, 3) sRGB-encoded bytes, as displayed.
        images: method name to the candidate's frames, the same.
    """

    scene: FilmedScene
    reference: NDArray[np.uint8]
    images: Mapping[str, NDArray[np.uint8]]

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Filmed({self.scene.name!r}, {', '.join(self.images)})"


@dataclass(frozen=True, eq=False)
class Plot:
    """One of the paper's plots for this material: an image for each method and an image of the reference.

    Args:
        name: `temporal-slice` (figure 4), `half-pixel-shift` (figure 6) or `apparent-brdf` (figure 8).
        title, caption: what a reader is told.
        reference, images: (h, w, 3) linear radiance, to be tonemapped like renders.
    """

    name: str
    title: str
    caption: str
    reference: Image
    images: Mapping[str, Image]

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Plot({self.name!r}, {', '.join(self.images)})"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that a comparison found.

    Args:
        name: name of the texture set.
        subject: name of the method that the verdict is about: the opened stack, else what comes first.
        model, pixel_filter: of the stacks.
        methods: what was compared, the subject first.
        curve: SNR of each method and pair set by level of detail, in steps of 1/4.
        figures: every measure of each method, view and scale.
        rendered, films, plots: images.
        source: what was read of the set, as `mipbake inspect --json` says it.
        notes: what a reader must know, in sentences.
        warnings: what is wrong, in sentences: a stack of another set, a reference that did not converge.
        foreign: whether the opened stack was baked from another texture set, which is one of the warnings.
        settings: seed, points, samples, resolution and so on.
        seconds: by phase.
    """

    name: str
    subject: str
    model: str
    pixel_filter: str
    methods: tuple[Method, ...]
    curve: tuple[Figure, ...]
    figures: tuple[Figure, ...]
    rendered: tuple[Rendered, ...] = ()
    films: tuple[Filmed, ...] = ()
    plots: tuple[Plot, ...] = ()
    source: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    foreign: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Comparison({self.name!r}, {self.model}: {', '.join(method.name for method in self.methods)})"

    def figure(self, method: str, measure: str, view: str, scale: str) -> Figure:
        """The one figure of these names; KeyError where it was not measured."""
        return _only(self.figures, (method, measure, view, scale), ("method", "measure", "view", "scale"))

    def point(self, method: str, measure: str, view: str, lod: float) -> Figure:
        """The one point of a curve; KeyError where it was not measured."""
        return _only(self.curve, (method, measure, view, lod), ("method", "measure", "view", "lod"))

    def to_dict(self) -> dict[str, Any]:
        """The comparison in plain types, without the images."""
        return {
            "name": self.name,
            "subject": self.subject,
            "model": self.model,
            "pixel_filter": self.pixel_filter,
            "methods": [asdict(method) for method in self.methods],
            "scales": {name: list(lods) for name, lods in SCALES.items()},
            "curve": [asdict(figure) for figure in self.curve],
            "figures": [asdict(figure) for figure in self.figures],
            "scenes": [asdict(each.scene) for each in self.rendered],
            "films": [asdict(each.scene) for each in self.films],
            "plots": [{"name": plot.name, "title": plot.title, "caption": plot.caption} for plot in self.plots],
            "source": dict(self.source),
            "notes": list(self.notes),
            "warnings": list(self.warnings),
            "foreign": self.foreign,
            "settings": dict(self.settings),
            "seconds": dict(self.seconds),
        }


def file_stem(*names: str) -> str:
    """Names of scenes and methods as a part of a file's name: what is not a letter or digit becomes a hyphen."""
    return "--".join(re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "image" for name in names)


def _only(figures: Iterable[Figure], wanted: tuple[object, ...], keys: tuple[str, ...]) -> Figure:
    for figure in figures:
        if tuple(getattr(figure, key) for key in keys) == wanted:
            return figure
    raise KeyError(wanted)
