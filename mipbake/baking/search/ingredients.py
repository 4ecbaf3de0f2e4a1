"""Ingredients of a blend: stacks that may be baked, looked up at the points of several sets of renders, and scored.

Closed forms are measured together, in one pass over the image, and of their levels only the texels are made that
lookups read (touched.py). Where that cannot be, an ingredient is baked, looked up at all points and, unless there is
memory to keep it, forgotten: 4096 x 4096 sets do not need fifteen stacks in memory. That is so for models that store
directions, whose signs hang on whole levels, and with a deadline that not all can meet. Ingredients that would take too
long are left out then, the ones that matter least first, and what was forgotten is not blended.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.prefilter import Prefilter, Progress
from mipbake.baking.rules import RULES
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.lean import Lean
from mipbake.baking.rules.together import Placed, Together
from mipbake.baking.search import pixel_samples
from mipbake.baking.search.touched import Touched, mixed
from mipbake.base.threads import MOSTLY_PYTHON, on_threads, side_by_side
from mipbake.material import MODELS, directions
from mipbake.material.directions import facing
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.scores import Score, Scores, between_levels
from mipbake.quality.judging.terms import LOG_ERRORS, POOLED, TERMS, Array, Term
from mipbake.quality.reference.problem import Image, Problem

KERNEL_OF_ORIGIN = "box"
BASE = "linear"
PLAIN = ("linear", "lean")
"""What engines and tools do, and the strongest rule: what a blend is held against under the brightest pairs, and in
every group of pairs, where they look fine."""

BLENDED = ("linear", "lean", "unreal", "godot")
"""Closed forms that may be ingredients of a blend, each with the pixel filter; BASE also with the box."""

# Logarithm by which a closed form may be behind the best as fitted to, and still be one for the judge.
_FAR = 0.35
_MEMORY = 1 << 30  # bytes of blended ingredients that are kept rather than baked twice
_PILOT = 256  # texels a side of the part that says how long an ingredient will take
_MARGIN = 1.1  # factor on what that part says
# Values of a stack up to which two ingredients are baked at a time.
_SIDE_BY_SIDE = 1 << 25


@dataclass(frozen=True)
class Ingredient:
    """A stack that may be baked.

    Args:
        name: what people call it: `lean (box)`, `neural`.
        closed_form: whether it is one.
        bake: gives its levels. part: bakes a part of level 0, to see how long it takes.
        form: what it makes of an image by averages with a kernel, and the kernel; None for no closed form.
    """

    name: str
    closed_form: bool
    bake: Callable[[], list[Image]]
    part: Callable[[Image], object]
    form: Callable[[Whole], tuple[Form, str]] | None = None


@dataclass(frozen=True, eq=False)
class Rivals:
    """The best closed forms at a level of detail.

    Args:
        names: of the best one of each pair set. log_errors: (S, G) its row of a Score.
    """

    names: tuple[str, ...]
    log_errors: Array


def closed_forms(problem: Problem) -> Iterator[Ingredient]:
    """Every closed form, with the pixel filter and with the box as its averaging kernel."""
    for kernel in dict.fromkeys((problem.pixel_filter, KERNEL_OF_ORIGIN)):
        for rule in RULES.values():
            yield ingredient(problem, rule, kernel)


def ingredient(problem: Problem, method: Prefilter, kernel: str) -> Ingredient:
    """A method as an ingredient."""

    def bake(stored: Image) -> list[Image]:
        return method(stored, problem.source, problem.target, kernel, problem.wrap, lambda _: None).levels

    name = f"{method.name} ({kernel})" if method.averages else method.name
    form = (lambda whole: (method.form(whole, problem.target), kernel)) if isinstance(method, ClosedForm) else None
    return Ingredient(name, method.averages, lambda: bake(problem.stored), bake, form)


def _rule(name: str) -> str:
    """`lean` of the ingredient `lean (box)`."""
    return name.partition(" ")[0]


def _plain(forms: Iterable[str]) -> list[str]:
    return [name for name in forms if _rule(name) in PLAIN]


class Bench:
    """All ingredients, looked up at all points of several sets of renders, and scored by all sets but the last, which
    is held out.

    With a deadline that not all can meet, ingredients that are not baked by then are left out, and the blend mixes what
    was kept.

    `typical` is (C,) a material that shades about as bright as the whole set, in the model PLAIN of pixel_samples.py;
    None where closed forms were not measured together. `pressing` is the time.monotonic() by which all would be made
    where the deadline is too early for that; None where it is not.
    """

    def __init__(
        self,
        problem: Problem,
        ingredients: Sequence[Ingredient],
        scores: Sequence[Scores],
        held_out: Scores,
        progress: Progress,
        deadline: float,
    ) -> None:
        self.problem, self._scores, self._held_out = problem, scores, held_out
        self._ingredients = {each.name: each for each in ingredients}
        form = f"{{}} ({problem.pixel_filter})"
        self.base = form.format(BASE)
        others = [form.format(name) for name in BLENDED[1:]]
        others += [f"{BASE} ({KERNEL_OF_ORIGIN})", *(each.name for each in ingredients if not each.closed_form)]
        others = [name for name in dict.fromkeys(others) if name in self._ingredients and name != self.base]
        # Networks take longest, and are worth most.
        first = [*(each.name for each in ingredients if not each.closed_form), self.base, *others]
        texels = sum(height * width for height, width in problem.sizes) * MODELS[problem.target].channels
        self._keep = list(dict.fromkeys(first))[: max(2, _MEMORY // (4 * texels))]
        self._kept: dict[str, list[Image]] = {}
        self._seen: dict[tuple[str, int, int, int], Image] = {}
        self._found: dict[tuple[str, int], list[Score]] = {}
        self.pressing = self._pressing(deadline)
        pressed = self.pressing is not None
        # Signs of directions hang on whole levels: without them, levels of closed forms need not exist.
        self._forms_of_whole: dict[str, tuple[Form, str]] = {}
        self._whole = Whole(problem.stored, problem.source)
        self.typical: Image | None = None
        if not pressed and MODELS[problem.target].lines is None:
            made = {each.name: each.form(self._whole) for each in ingredients if each.form is not None}
            self._forms_of_whole = made
        names = [name for name in dict.fromkeys([*first, *self._ingredients]) if name not in self._forms_of_whole]

        def look(name: str) -> bool:
            if pressed and name != self.base and time.monotonic() + self._expected(name) > deadline:
                return False
            levels = self.levels(name)
            for which, each in enumerate((*scores, held_out)):
                self._see(name, levels, which, each)
            self._found[name, 0] = [self._score(name, 0, index) for index in range(len(scores[0].probes))]
            return True

        done = {name: True for name in self._forms_of_whole}
        if done:
            self._look_together((*scores, held_out), others)
            progress(len(done) / (len(self._ingredients) + 1))
        else:
            done[self.base] = look(self.base)
            names.remove(self.base)
        # Closed forms are NumPy, which uses one core; stacks of large sets do not fit into memory twice. One thread is
        # the caller's own, which hears Ctrl-C between the bands of a network.
        before, count = len(done), len(self._ingredients) + 1
        looked = on_threads(
            lambda index: look(names[index]),
            len(names),
            lambda share: progress((before + share * (len(names) + 1)) / count),
            most=MOSTLY_PYTHON if texels <= _SIDE_BY_SIDE else 1,
        )
        done.update(zip(names, looked, strict=True))
        self.left_out = tuple(name for name, each in self._ingredients.items() if each.closed_form and not done[name])
        self._ingredients = {name: each for name, each in self._ingredients.items() if done[name]}
        self.others = [name for name in others if done[name] and not (pressed and name not in self._kept)]
        if pressed:
            self._ingredients = {
                name: each for name, each in self._ingredients.items() if each.closed_form or name in self._kept
            }
        self.judged = side_by_side(self._judged, range(len(scores[1].probes)))
        self._baked = set(self._kept) if pressed else set(self._ingredients)

    def _pressing(self, deadline: float) -> float | None:
        """The time.monotonic() by which all would be made, where a deadline is too early for that; else None."""
        if math.isinf(deadline):
            return None
        once = sum(self._expected(name) for name in self._ingredients)
        ready = time.monotonic() + 2 * once  # each is made at most twice: to be looked up, and to be blended
        return ready if ready > deadline else None

    def _expected(self, name: str) -> float:
        """Seconds that an ingredient will take, from a part of the set."""
        height, width = self.problem.stored.shape[:2]
        rows, columns = (min(_PILOT, max(1, side // 2)) for side in (height, width))
        began = time.monotonic()
        self._ingredients[name].part(np.ascontiguousarray(self.problem.stored[:rows, :columns]))
        return _MARGIN * (time.monotonic() - began) * float(height * width) / float(rows * columns)

    def levels(self, name: str) -> list[Image]:
        """Every level of an ingredient, baked again unless it was kept."""
        if name in self._kept:
            return self._kept[name]
        levels = self._ingredients[name].bake()
        lines = MODELS[self.problem.target].lines
        if lines is not None and name != self.base:
            # Directions d and -d are one; blends must not cancel.
            for level, base in zip(levels, self.levels(self.base), strict=True):
                own = level[..., lines.direction]
                own *= facing(own, base[..., lines.direction])[..., None]
        if name in self._keep:
            self._kept[name] = levels
        return levels

    def _look_together(self, sets: Sequence[Scores], others: Sequence[str]) -> None:
        """Looks all closed forms up, of which only the texels that lookups read are made."""
        touched = Touched(self.problem, sets)
        typical = Lean().form(self._whole, pixel_samples.PLAIN.name), self.problem.pixel_filter
        together = Together(self._whole, [*self._forms_of_whole.values(), typical], self.problem.wrap)
        touched.gather(together)
        self.typical = touched.made(together.placed[-1], self.problem.last, pixel_samples.PLAIN)[0]

        def look(named: tuple[str, Placed]) -> None:
            name, placed = named
            for level in range(self.problem.last + 1):
                texels = touched.made(placed, level)
                for which, each in enumerate(sets):
                    for index, probe in enumerate(each.probes):
                        if level in probe.levels:
                            self._seen[name, which, index, level] = touched.seen(texels, which, index, level)
            self._found[name, 0] = [self._score(name, 0, index) for index in range(len(sets[0].probes))]
            if name not in (self.base, *others):
                for index, probe in enumerate(sets[0].probes):
                    for level in probe.levels:
                        del self._seen[name, 0, index, level]  # only blends are fitted again

        side_by_side(look, zip(self._forms_of_whole, together.placed[:-1], strict=True))

    def _see(self, name: str, levels: list[Image], which: int, scores: Scores) -> None:
        for index, probe in enumerate(scores.probes):
            for level in probe.levels:
                self._seen[name, which, index, level] = scores.looked_up(levels[level], index)

    def _score(self, name: str, which: int, index: int) -> Score:
        levels = self._scores[which].probes[index].levels
        return self._scores[which].of(between_levels([self.seen(name, which, index, level) for level in levels]), index)

    def _judged(self, index: int) -> dict[str, Score]:
        """Closed forms at a level of detail as the judge sees them: those that are not far behind as fitted to."""
        forms = self._forms(0, index)
        logs = np.stack([each.terms for each in forms.values()])
        near = (logs < logs.min(0) + _FAR).any(1)
        return {
            name: self._score(name, 1, index)
            for name, close in zip(forms, near, strict=True)
            if close or _rule(name) in PLAIN
        }

    def seen(self, name: str, which: int, index: int, level: int) -> Image:
        """(N, C): a level of an ingredient at the points of a probe."""
        return self._seen[name, which, index, level]

    def fitted(self, which: int, index: int, level: int, shares: NDArray[np.float32]) -> Image:
        """(N, C): a fitted blend there."""
        base, others = self.parts(which, index, level)
        return material.regularise(blended(base, others, shares, self.problem.target), self.problem.target)

    def parts(self, which: int, index: int, level: int) -> tuple[Image, list[Image]]:
        """What blends are made of, at the points of a probe."""
        return self.seen(self.base, which, index, level), [self.seen(n, which, index, level) for n in self.others]

    @staticmethod
    def _best(forms: Mapping[str, Score], term: Term) -> str:
        """The best of closed forms by a term: under bright pairs the best of PLAIN."""
        return min(_plain(forms) if term.array == POOLED else forms, key=lambda name: term.value(forms[name]))

    def baseline(self, which: int, index: int, looks_worse: float) -> Baseline:
        """That no closed form that looks fine is ahead at a level of detail, none of PLAIN in a group of pairs, and no
        ingredient by what people see.

        Args:
            looks_worse: nepers of a term of pictures by which a closed form may be behind the best ingredient and looks
                fine. BASE always does.
        """
        forms = self._forms(which, index)
        # By what people see no ingredient may be ahead, networks included: what they win is not given away again.
        every = [*forms.values(), *(self._score(name, which, index) for name in self._learned)]
        means = np.array([[term.value(score) for term in TERMS.values() if term.visible] for score in every])
        fine = (means - means.min(0) <= looks_worse).all(-1)[: len(forms)]
        looks = zip(forms.items(), fine, strict=True)
        forms = {name: each for (name, each), good in looks if good or _rule(name) == BASE}
        best = {
            name: min(every, key=term.value) if term.visible else forms[self._best(forms, term)]
            for name, term in TERMS.items()
        }
        plain = np.min([forms[name].log_errors for name in _plain(forms)], 0)
        return Baseline({name: term.values(best[name]) for name, term in TERMS.items()}, plain)

    def _forms(self, which: int, index: int) -> dict[str, Score]:
        """Scores of closed forms: all as fitted to, and those that are not far behind as the judge sees them."""
        if which:
            return self.judged[index]
        return {name: self._found[name, 0][index] for name, each in self._ingredients.items() if each.closed_form}

    @property
    def _learned(self) -> list[str]:
        return [name for name, each in self._ingredients.items() if not each.closed_form]

    def rivals(self, index: int) -> Rivals:
        """The closed forms that are the best at a level of detail by the renders that judge, as the held-out set has
        them."""
        forms = self._forms(1, index)
        pairs = [term for term in TERMS.values() if term.array == LOG_ERRORS]
        names = tuple(self._best(forms, term) for term in pairs)
        scores = {name: self._held_out_score(name, index) for name in names}
        rows = [term.values(scores[name]) for name, term in zip(names, pairs, strict=True)]
        return Rivals(names, np.stack(rows))

    def _held_out_score(self, name: str, index: int) -> Score:
        levels = self._held_out.probes[index].levels
        texels = [self.seen(name, len(self._scores), index, level) for level in levels]
        return self._held_out.of(between_levels(texels), index)

    def plain_visible(self, index: int) -> Array:
        """(V,) logarithm of the visible error that plain MIP maps have at a level of detail in the held-out set."""
        box = f"{BASE} ({KERNEL_OF_ORIGIN})"
        return np.asarray(self._held_out_score(box if box in self._ingredients else self.base, index).visible.mean(-1))

    def safest(self, level: int, judge: Judge) -> str:
        """The ingredient that is worth most at a level by itself, as fitted to."""
        index = 2 * level
        names = [name for name in self._ingredients if name in self._baked]
        return min(names, key=lambda name: judge.value(self._found[name, 0][index], index))

    def mixture(self, shares: NDArray[np.float32], safe: str, kept: float) -> dict[str, Array]:
        """Names and (C,) shares of what a level is summed from: a blend, as much as is kept of it, and what is safe."""
        layout = MODELS[self.problem.target]
        out: dict[str, Array] = {}
        if kept < 1:
            out[safe] = np.full(layout.channels, 1 - kept)
        if kept > 0:
            count, own = len(self.others), np.full(layout.channels, kept)
            for k, name in enumerate(self.others):
                share = np.zeros(layout.channels)
                for index, channels in enumerate(layout.maps.values()):
                    share[channels] = kept * shares[index * count + k]
                if share.any():
                    out[name] = out.get(name, 0) + share
                    own -= share
            out[self.base] = out.get(self.base, 0) + own
        return out

    def mixed(self, mixtures: Sequence[Mapping[str, Array]]) -> list[Image]:
        """The levels of mixtures, one each."""
        target = self.problem.target
        if self._forms_of_whole:
            names = dict.fromkeys(name for mixture in mixtures for name in mixture)
            baked = {name: self.levels(name) for name in names if name not in self._forms_of_whole}
            self._kept.clear()  # what was kept is written over
            return mixed(self.problem, self._whole, self._forms_of_whole, baked, mixtures)
        shapes = [(*size, MODELS[target].channels) for size in self.problem.sizes]
        out = [np.zeros(shape, np.float32) for shape in shapes]
        for name in dict.fromkeys(name for mixture in mixtures for name in mixture):
            levels = self.levels(name)
            for level, mixture in enumerate(mixtures):
                if name in mixture:
                    out[level] += levels[level] * mixture[name].astype(np.float32)
        out = [material.regularise(level, target) for level in out]
        return directions.aligned(out, target, self.problem.wrap)


def blended(base: Image, others: Sequence[Image], shares: NDArray[np.float32], model: str) -> Image:
    """(..., C) the blend that shares of level_fit.columns stand for, before it is made valid."""
    out: Image = base.copy()
    for index, channels in enumerate(MODELS[model].maps.values()):
        for k, other in enumerate(others):
            share = shares[index * len(others) + k]
            if share:
                out[..., channels] += share * (other[..., channels] - base[..., channels])
    return out
