"""What a comparison found: plain dataclasses, which `results.json` and the page of a report are written from; and which
method is the one to beat."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.baking.methods import METHODS
from mipbake.base.timings import PhaseProgress
from mipbake.quality.figures import SCALES, Figure, Method
from mipbake.source.texture_set import TextureSet
from mipbake.stack.stack import MipStack

LINEAR, OPTIMUM = "linear (box)", "optimum"
"""Names of what engines do today, and of the limit of what a stack can show."""

Image = NDArray[np.float32]
"""(H, W, 3) linear radiance, rows from the top."""


@dataclass(frozen=True)
class Scene:
    """A render that methods were compared in.

    Args:
        name: key: `sphere-near`, `plane`, ...
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


@dataclass(frozen=True, eq=False, repr=False)
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


@dataclass(frozen=True)
class FilmedScene:
    """A film that methods were compared in.

    Args:
        name: key, and the view of its figures: `film-floor`, `film-low-floor`, ...
        motion: what moves, `camera` or `light`. sampler: how stacks were looked up.
        lod: median level of detail of the first frame's covered pixels.
        exposure: at which all frames are displayed.
        noise: of the reference; candidate_error: of the closest candidate; both root mean squares of displayed values.
        converged: whether the first is at most the wanted share of the second. The rest is as in `Scene`.
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


@dataclass(frozen=True, eq=False, repr=False)
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


@dataclass(frozen=True, eq=False, repr=False)
class Plot:
    """One of the paper's plots for this material: an image for each method and an image of the reference.

    Args:
        name: `temporal-slice` (figure 4), `half-pixel-shift` (figure 6) or `apparent-brdf` (figure 8).
        title, caption: what a reader is shown.
        reference, images: (h, w, 3) linear radiance, to be tonemapped like renders.
    """

    name: str
    title: str
    caption: str
    reference: Image
    images: Mapping[str, Image]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that a comparison found.

    Args:
        name: name of the texture set.
        subject: name of the method that the verdict is about: the opened stack, else the first but for plain MIP maps.
        model, pixel_filter: of the stacks.
        methods: what was compared, the subject first.
        curve: SNR of each method and pair set by level of detail, in steps of 1/4.
        figures: every measure of each method, view and scale.
        rendered, films, plots: images.
        stacks: of the subject and `linear (box)`, by method name.
        source: what was read of the set, as `mipbake inspect --json` says it.
        texture_set: what was compared, which the interactive view of a page shows.
        notes: what figures leave out, in sentences: limits of models, a reference that did not converge.
        warnings: what a reader can do something about, in sentences: a stack of another set, a judge that is missing.
        foreign: whether the opened stack was baked from another texture set, which is one of the warnings.
        settings: seed, resolution and so on.
        seconds: by phase.
    """

    name: str
    subject: str
    model: str
    pixel_filter: str
    methods: tuple[Method, ...]
    curve: tuple[Figure, ...] = ()
    figures: tuple[Figure, ...] = ()
    rendered: tuple[Rendered, ...] = ()
    films: tuple[Filmed, ...] = ()
    plots: tuple[Plot, ...] = ()
    stacks: Mapping[str, MipStack] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)
    texture_set: TextureSet | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    foreign: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        """A description in one line."""
        return f"Comparison({self.name!r}, {self.model}: {', '.join(method.name for method in self.methods)})"

    def save(self, path: str | Path, progress: PhaseProgress = lambda _phase, _share: None) -> list[Path]:
        """Writes the report that `mipbake compare` writes into the folder `path`: a page for the browser, index.html,
        and its figures, results.json. An earlier report there is replaced.

        Raises:
            OutputError: the folder cannot be written, or holds something else.
        """
        from mipbake.comparing.page import write_report

        source = None if self.texture_set is None else self.texture_set.filtered(self.pixel_filter)
        return write_report(self, source, Path(path), progress)

    @cached_property
    def _figures(self) -> Mapping[tuple[str, str, str, str], Figure]:
        return {(f.method, f.measure, f.view, f.scale): f for f in reversed(self.figures)}

    def find(self, method: str, measure: str, view: str, scale: str) -> Figure | None:
        """The one figure of these names; None where it was not measured."""
        return self._figures.get((method, measure, view, scale))

    def figure(self, method: str, measure: str, view: str, scale: str) -> Figure:
        """The same; KeyError where it was not measured."""
        return self._figures[method, measure, view, scale]

    @property
    def closed_forms(self) -> list[str]:
        """Names of the methods other than the subject that average and have no trained weights."""
        others = [each for each in self.methods if each.name != self.subject]
        return [each.name for each in others if each.method in METHODS and METHODS[each.method].averages]

    @property
    def best_closed_form(self) -> str | None:
        """The closed form whose SNR is the highest in the mean over scales and pair sets; None without figures."""
        means = {}
        for name in self.closed_forms:
            found = [f.value for f in self.figures if f.measure == "snr" and f.method == name and f.scale]
            if found and not any(math.isnan(value) for value in found):
                means[name] = sum(found) / len(found)
        return max(means, key=means.__getitem__, default=None)

    def to_dict(self) -> dict[str, Any]:
        """The comparison in plain types, without images and stacks."""
        records = {name: [asdict(each) for each in getattr(self, name)] for name in ("methods", "curve", "figures")}
        return {
            **{name: getattr(self, name) for name in ("name", "subject", "model", "pixel_filter")},
            "methods": records.pop("methods"),
            "scales": {name: list(lods) for name, lods in SCALES.items()},
            **records,
            "scenes": [asdict(each.scene) for each in self.rendered],
            "films": [asdict(each.scene) for each in self.films],
            "plots": [{"name": plot.name, "title": plot.title, "caption": plot.caption} for plot in self.plots],
            "source": dict(self.source),
            "notes": list(self.notes),
            "warnings": list(self.warnings),
            **{name: getattr(self, name) for name in ("foreign", "settings", "seconds")},
        }
