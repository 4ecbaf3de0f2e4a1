"""Ingredients of a blend: stacks that may be baked, looked up at the points of three sets of renders, and scored.

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
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from mipbake.baking.prefilter import Prefilter, Progress
from mipbake.baking.rules import RULES
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.lean import Lean
from mipbake.baking.rules.together import Placed, Together
from mipbake.baking.search import pixel_samples
from mipbake.baking.search.touched import Touched
from mipbake.base.threads import MOSTLY_PYTHON, on_threads, side_by_side
from mipbake.material import MODELS
from mipbake.material.directions import facing
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Score, Scores, between_levels
from mipbake.quality.judging.terms import LOG_ERRORS, POOLED, TERMS, Array, Term, Weights
from mipbake.quality.reference.problem import Image, Problem

KERNEL_OF_ORIGIN = "box"
BASE = "linear"
PLAIN = ("linear", "lean")
"""What engines and tools do, and the strongest rule: what a blend is held against under the brightest pairs, and in
every group of pairs, where they look fine."""

BLENDED = ("linear", "lean", "unreal", "godot")
"""Closed forms that may be ingredients of a blend, each with the pixel filter; BASE also with the box."""

TRAIN, CHECK, HELD_OUT = range(3)
"""Sets of renders: what blends are fitted to; what judges, which nothing is fitted to; what decides nothing."""

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


def renders(problem: Problem, effort: ProbeEffort, seed: int, first: int = TRAIN) -> list[Scores]:
    """The sets of renders at levels of detail in steps of 1/2, from the first that is wanted on."""
    # A handful of shares a level needs fewer points than to decide what is kept of them.
    fewer = replace(
        effort,
        groups=max(1, 2 * effort.groups // 3),
        points=max(1, 3 * effort.points // 4),
        pictures=max(1, effort.pictures // 2),
    )
    efforts = (fewer, effort, replace(effort, groups=max(2, effort.groups // 2), pictures=1))
    with ThreadPoolExecutor(2) as pool:
        drawn = [pool.submit(Scores, problem, efforts[which], 3 * seed + which) for which in range(first, 3)]
        return [each.result() for each in drawn]


def _rule(name: str) -> str:
    """`lean` of the ingredient `lean (box)`."""
    return name.partition(" ")[0]


def _plain(forms: Iterable[str]) -> list[str]:
    return [name for name in forms if _rule(name) in PLAIN]


class Bench:
    """All ingredients, looked up in the sets of renders, and scored by all of these but the last, which is held out.

    `sets` are the renders. `fitting` is what stacks are worth by the first, `judge` by the second, held against the
    best closed forms that look fine. `base` and `others` may be blended. `typical` is (C,) a material that shades about
    as bright as the whole set, in the model PLAIN of pixel_samples.py; None where closed forms were not measured
    together. `pressing` is the time.monotonic() by which all would be made where the deadline is too early for that;
    None where it is not. `left_out` are closed forms that there was no time to bake.

    Args:
        ingredients: in the order of preference where they measure the same, BASE with the pixel filter among them. A
            network need not be.
        effort: of the renders that judge; those that are fitted to have half the points.
        judged_by: what errors count.
        deadline: time.monotonic() by which all ingredients are baked; ingredients that would not be are left out.
    """

    def __init__(
        self,
        problem: Problem,
        ingredients: Sequence[Ingredient],
        effort: ProbeEffort,
        judged_by: Weights,
        seed: int = 0,
        progress: Progress = lambda _: None,
        deadline: float = math.inf,
    ) -> None:
        self.problem, self.sets = problem, renders(problem, effort, seed)
        self._ingredients = {each.name: each for each in ingredients}
        form = f"{{}} ({problem.pixel_filter})"
        self.base = form.format(BASE)
        networks = [each.name for each in ingredients if not each.closed_form]
        others = [*(form.format(name) for name in BLENDED[1:]), f"{BASE} ({KERNEL_OF_ORIGIN})", *networks]
        others = [name for name in dict.fromkeys(others) if name in self._ingredients and name != self.base]
        # Networks take longest, and are worth most.
        first = [*networks, self.base, *others]
        texels = sum(height * width for height, width in problem.sizes) * MODELS[problem.target].channels
        self._keep = list(dict.fromkeys(first))[: max(2, _MEMORY // (4 * texels))]
        self._kept: dict[str, list[Image]] = {}
        self._seen: dict[tuple[str, int, int, int], Image] = {}
        self._fitted_to: dict[str, list[Score]] = {}
        self.pressing = self._pressing(deadline)
        pressed = self.pressing is not None
        self.whole = Whole(problem.stored, problem.source)
        self.typical: Image | None = None
        # Signs of directions hang on whole levels: without them, levels of closed forms need not exist.
        self.forms: dict[str, tuple[Form, str]] = {}
        if not pressed and MODELS[problem.target].lines is None:
            self.forms = {each.name: each.form(self.whole) for each in ingredients if each.form is not None}

        def look(name: str) -> bool:
            if pressed and name != self.base and time.monotonic() + self._expected(name) > deadline:
                return False
            levels = self.levels(name)
            for which, scores in enumerate(self.sets):
                for index, probe in enumerate(scores.probes):
                    for level in probe.levels:
                        self._seen[name, which, index, level] = scores.looked_up(levels[level], index)
            self._score_train(name)
            return True

        names = [name for name in dict.fromkeys([*first, *self._ingredients]) if name not in self.forms]
        done = dict.fromkeys(self.forms, True)
        if done:
            self._look_together(others)
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
        # In a hurry, networks that are not kept take no part, and nothing is baked again.
        self._ingredients = {
            name: each
            for name, each in self._ingredients.items()
            if done[name] and (not pressed or each.closed_form or name in self._kept)
        }
        self.others = [name for name in others if done[name] and not (pressed and name not in self._kept)]
        self._baked = set(self._kept) if pressed else set(self._ingredients)
        lods = range(len(self.check.lods))
        self.judged = side_by_side(self._judged, lods)
        self.fitting, self.judge = (
            Judge([self.baseline(which, index, judged_by.looks_worse) for index in lods], judged_by)
            for which in (TRAIN, CHECK)
        )

    @property
    def check(self) -> Scores:
        """The renders that judge."""
        return self.sets[CHECK]

    def _pressing(self, deadline: float) -> float | None:
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

    def taken(self, names: Iterable[str]) -> dict[str, list[Image]]:
        """Levels of ingredients, to be written over: no longer kept."""
        levels = {name: self.levels(name) for name in names}
        self._kept.clear()
        return levels

    def _look_together(self, others: Sequence[str]) -> None:
        """Looks all closed forms up, of which only the texels that lookups read are made."""
        problem = self.problem
        touched = Touched(problem, self.sets)
        typical = Lean().form(self.whole, pixel_samples.PLAIN.name), problem.pixel_filter
        together = Together(self.whole, [*self.forms.values(), typical], problem.wrap)
        touched.gather(together)
        self.typical = touched.made(together.placed[-1], problem.last, pixel_samples.PLAIN)[0]

        def look(named: tuple[str, Placed]) -> None:
            name, placed = named
            for level in range(problem.last + 1):
                texels = touched.made(placed, level)
                for which, index in touched.probes(level):
                    self._seen[name, which, index, level] = touched.seen(texels, which, index, level)
            self._score_train(name)
            if name not in (self.base, *others):  # only blends are fitted again
                for level in range(problem.last + 1):
                    for which, index in touched.probes(level):
                        if which == TRAIN:
                            del self._seen[name, which, index, level]

        side_by_side(look, zip(self.forms, together.placed[:-1], strict=True))

    def _score_train(self, name: str) -> None:
        self._fitted_to[name] = [self._score(name, TRAIN, index) for index in range(len(self.sets[TRAIN].probes))]

    def _score(self, name: str, which: int, index: int) -> Score:
        scores = self.sets[which]
        return scores.of(between_levels([self.seen(name, which, index, n) for n in scores.probes[index].levels]), index)

    def _judged(self, index: int) -> dict[str, Score]:
        """Closed forms at a level of detail as the judge sees them: those that are not far behind as fitted to."""
        forms = self._forms(TRAIN, index)
        logs = np.stack([each.terms for each in forms.values()])
        near = (logs < logs.min(0) + _FAR).any(1)
        return {
            name: self._score(name, CHECK, index)
            for name, close in zip(forms, near, strict=True)
            if close or _rule(name) in PLAIN
        }

    def _forms(self, which: int, index: int) -> dict[str, Score]:
        """Scores of closed forms: all as fitted to, and those that are not far behind as the judge sees them."""
        if which == CHECK:
            return self.judged[index]
        return {name: self._fitted_to[name][index] for name, each in self._ingredients.items() if each.closed_form}

    def seen(self, name: str, which: int, index: int, level: int) -> Image:
        """(N, C): a level of an ingredient at the points of a probe."""
        return self._seen[name, which, index, level]

    def parts(self, which: int, index: int, level: int) -> tuple[Image, list[Image]]:
        """What blends are made of, at the points of a probe: BASE, and the others."""
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
        networks = [name for name, each in self._ingredients.items() if not each.closed_form]
        every = [*forms.values(), *(self._score(name, which, index) for name in networks)]
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

    def rivals(self, index: int) -> Rivals:
        """The closed forms that are the best at a level of detail by the renders that judge, as the held-out set has
        them."""
        pairs = [term for term in TERMS.values() if term.array == LOG_ERRORS]
        names = tuple(self._best(self._forms(CHECK, index), term) for term in pairs)
        scores = {name: self._score(name, HELD_OUT, index) for name in names}
        rows = [term.values(scores[name]) for name, term in zip(names, pairs, strict=True)]
        return Rivals(names, np.stack(rows))

    def plain_visible(self, index: int) -> Array:
        """(V,) logarithm of the visible error that plain MIP maps have at a level of detail in the held-out set."""
        box = f"{BASE} ({KERNEL_OF_ORIGIN})"
        name = box if box in self._ingredients else self.base
        return np.asarray(self._score(name, HELD_OUT, index).visible.mean(-1))

    def safe(self, level: int) -> str:
        """The ingredient that is worth most at a level by itself, as fitted to."""
        index = 2 * level
        names = [name for name in self._ingredients if name in self._baked]
        return min(names, key=lambda name: self.fitting.value(self._fitted_to[name][index], index))
