"""`linear`: average every stored channel and renormalise the normal.

With the box filter this is what GPUs and most tools do; with a pixel filter, level 0 is filtered too.
"""

from __future__ import annotations

from mipbake import material
from mipbake.baking.rules.bands import Array
from mipbake.baking.rules.closed_form import ClosedForm
from mipbake.baking.rules.form import Form, Whole, stored_part


class Linear(ClosedForm):
    """Averages of the stored channels of the target model, under the pixel filter."""

    name = "linear"
    summary = "average of every stored channel (what GPUs do, with the pixel filter in place of the box)"

    def form(self, whole: Whole, target: str) -> Form:
        """See ClosedForm."""
        channels = range(material.model_named(target).channels)

        def write(texels: Array, _: Array | None) -> Array:
            return material.regularise(texels, target)

        return Form([stored_part(whole.model, target, channels)], write, unread=whole.model == target)
