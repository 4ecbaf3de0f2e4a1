"""Ingredients of a blend: stacks that may be baked, looked up at the points of renders, and scored.

Closed forms are measured together, in one pass over the image, and of their levels only the texels are made that
lookups read (touched.py). Where that cannot be, because signs of directions hang on whole levels, an ingredient is
baked, looked up at all points and, unless there is memory to keep it, forgotten.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mipbake.baking.prefilter import Prefilter
from mipbake.baking.rules import RULES
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Form, Whole
from mipbake.baking.rules.lean import Lean
from mipbake.baking.rules.together import Placed, Together
from mipbake.baking.search import pixel_samples
from mipbake.baking.search.touched import Touched
from mipbake.base.threads import side_by_side
from mipbake.base.timings import Progress
from mipbake.material import MODELS
from mipbake.material.directions import facing
from mipbake.quality.judging.judge import Baseline, Judge
from mipbake.quality.judging.probes import ProbeEffort
from mipbake.quality.judging.scores import Score, Scores
from mipbake.quality.judging.terms import LOG_ERRORS, POOLED, TERMS, Array, Term, Weights
from mipbake.quality.reference.problem import Image, Problem

KERNEL_OF_ORIGIN = "box"
BASE = "linear"
PLAIN = ("linear", "lean")
"""What engines and tools do, and the strongest rule: what a blend is held against under the brightest pairs, and in
every group of pairs, where they look fine."""

BLENDED = ("linear", "lean", "unreal", "godot")
"""Closed forms that are ingredients of a blend, each with the pixel filter; BASE also with the box."""

FITTED, HELD_OUT = range(2)
"""Sets of renders: what blends are fitted to and held against; what decides nothing."""

_MEMORY = 1 << 30  # bytes of ingredients that are kept rather than baked twice


@dataclass(frozen=True)
class Ingredient:
    """A stack that may be baked.

    Args:
        name: what people call it: `lean (gaussian)`, `neural`.
        closed_form: whether it is one.
        bake: gives its levels.
        form: what it makes of an image by averages with a kernel, and the kernel; None for no closed form.
    """

    name: str
    closed_form: bool
    bake: Callable[[], list[Image]]
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
    """The closed forms of BLENDED, BASE first; where they measure the same, the first is preferred."""
    for rule in BLENDED:
        yield ingredient(problem, RULES[rule], problem.pixel_filter)
    if problem.pixel_filter != KERNEL_OF_ORIGIN:
        yield ingredient(problem, RULES[BASE], KERNEL_OF_ORIGIN)


def ingredient(problem: Problem, method: Prefilter, kernel: str) -> Ingredient:
    """A method as an ingredient."""

    def bake() -> list[Image]:
        args = problem.stored, problem.source, problem.target, kernel, problem.wrap
        return method(*args, lambda _: None).levels

    name = f"{method.name} ({kernel})" if method.averages else method.name
    form = (lambda whole: (method.form(whole, problem.target), kernel)) if isinstance(method, ClosedForm) else None
    return Ingredient(name, method.averages, bake, form)


def renders(problem: Problem, effort: ProbeEffort, seed: int) -> list[Scores]:
    """The sets of renders at every level, of which the held-out one has few pictures."""
    efforts = effort, replace(effort, groups=max(2, effort.groups // 2), pictures=1)
    return [Scores(problem, each, [seed, which], range(problem.last + 1)) for which, each in enumerate(efforts)]


def _rule(name: str) -> str:
    """`lean` of the ingredient `lean (gaussian)`."""
    return name.partition(" ")[0]


def _plain(forms: Iterable[str]) -> list[str]:
    return [name for name in forms if _rule(name) in PLAIN]


class Bench:
    """All ingredients, looked up in the sets of renders, and scored by the first.

    `sets` are the renders, `scores` those of all ingredients at every level, and `judge` says what stacks are worth,
    held against the best closed forms that look fine. Levels are blended from `base` and `others`. `typical` is (C,) a
    material that shades about as bright as the whole set, in the model PLAIN of pixel_samples.py; None where closed
    forms were not measured together.

    Args:
        ingredients: in the order of preference where they measure the same, BASE with the pixel filter among them. A
            network need not be.
        effort: of the renders that are fitted to and judge.
        judged_by: what errors count.
    """

    def __init__(
        self,
        problem: Problem,
        ingredients: Sequence[Ingredient],
        effort: ProbeEffort,
        judged_by: Weights,
        seed: int = 0,
        progress: Progress = lambda _: None,
    ) -> None:
        self.problem = problem
        self._ingredients = {each.name: each for each in ingredients}
        self.base = f"{BASE} ({problem.pixel_filter})"
        self.others = [name for name in self._ingredients if name != self.base]
        self._networks = [each.name for each in ingredients if not each.closed_form]
        texels = sum(height * width for height, width in problem.sizes) * MODELS[problem.target].channels
        # Networks take longest; of others as many as there is memory for.
        first = dict.fromkeys([*self._networks, self.base, *self.others])
        self._keep = list(first)[: max(2, _MEMORY // (4 * texels))]
        self._kept: dict[str, list[Image]] = {}
        self._seen: dict[tuple[str, int, int], Image] = {}
        self.sets = renders(problem, effort, seed)
        progress(0.3)
        self.whole = Whole(problem.stored, problem.source)
        self.typical: Image | None = None
        # Signs of directions hang on whole levels: without them, levels of closed forms need not exist.
        self.forms: dict[str, tuple[Form, str]] = {}
        if MODELS[problem.target].lines is None:
            self.forms = {each.name: each.form(self.whole) for each in ingredients if each.form is not None}
            self._look_together()
        progress(0.4)
        for name in dict.fromkeys([self.base, *self._ingredients]):
            if name not in self.forms:
                self._look(name)
        progress(0.7)
        self.scores = side_by_side(
            lambda level: {name: self._score(name, FITTED, level) for name in self._ingredients},
            range(problem.last + 1),
        )
        self.judge = Judge(
            [self.baseline(level, judged_by.looks_worse) for level in range(problem.last + 1)], judged_by
        )

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

    def _look(self, name: str) -> None:
        levels = self.levels(name)
        for which, scores in enumerate(self.sets):
            for level, texels in enumerate(levels):
                self._seen[name, which, level] = scores.looked_up(texels, level)

    def _look_together(self) -> None:
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
                for which in range(len(self.sets)):
                    self._seen[name, which, level] = touched.seen(texels, which, level)

        side_by_side(look, zip(self.forms, together.placed[:-1], strict=True))

    def _score(self, name: str, which: int, level: int) -> Score:
        return self.sets[which].of(self._seen[name, which, level], level)

    def looked_up(self, name: str, level: int) -> Image:
        """(N, C): a level of an ingredient at the points of the probe that it is fitted to."""
        return self._seen[name, FITTED, level]

    @staticmethod
    def _best(forms: Mapping[str, Score], term: Term) -> str:
        """The best of closed forms by a term: under bright pairs the best of PLAIN."""
        return min(_plain(forms) if term.array == POOLED else forms, key=lambda name: term.value(forms[name]))

    def baseline(self, level: int, looks_worse: float) -> Baseline:
        """That no closed form that looks fine is ahead at a level, none of PLAIN in a group of pairs, and no ingredient
        by what people see.

        Args:
            looks_worse: nepers of a term of pictures by which a closed form may be behind the best ingredient and looks
                fine. BASE always does.
        """
        scores = self.scores[level]
        # By what people see no ingredient may be ahead, networks included: what they win is not given away again.
        least = np.min([each.visible.mean(-1) for each in scores.values()], 0)
        forms = {
            name: each
            for name, each in scores.items()
            if name not in self._networks
            and (_rule(name) == BASE or (each.visible.mean(-1) - least <= looks_worse).all())
        }
        best = {
            name: min(scores.values(), key=term.value) if term.visible else forms[self._best(forms, term)]
            for name, term in TERMS.items()
        }
        plain = np.min([forms[name].log_errors for name in _plain(forms)], 0)
        return Baseline({name: term.values(best[name]) for name, term in TERMS.items()}, plain)

    def rivals(self, level: int) -> Rivals:
        """The closed forms that are the best at a level, as the held-out set has them."""
        scores = self.scores[level]
        forms = {name: each for name, each in scores.items() if name not in self._networks}
        pairs = [term for term in TERMS.values() if term.array == LOG_ERRORS]
        names = tuple(self._best(forms, term) for term in pairs)
        held_out = {name: self._score(name, HELD_OUT, level) for name in names}
        rows = [term.values(held_out[name]) for name, term in zip(names, pairs, strict=True)]
        return Rivals(names, np.stack(rows))

    def plain(self, level: int, which: int) -> Score:
        """The score of plain MIP maps at a level, by one of `sets`."""
        box = f"{BASE} ({KERNEL_OF_ORIGIN})"
        return self.scores[level][box] if which == FITTED else self._score(box, which, level)

    def safe(self, level: int) -> str:
        """The ingredient that is worth most at a level by itself; a network, unless another is surely worth more."""
        scores = self.scores[level]
        usual = next((scores[name] for name in self._networks), scores[self.base])
        return min(scores, key=lambda name: self.judge.worth(scores[name], usual, level))
