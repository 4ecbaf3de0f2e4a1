"""Fits: the texels of a stack, optimised in any renderer, also in one that only renders.

    fitted = mipbake.fit(stack, renderer, views, source=texture_set)

`renderer` is any object with a method `render(levels, view) -> Frame`. `mipbake.fitting.gl`, `.kernels`, `.three` and
`.process` have renderers that come with mipbake: OpenGL with a fragment shader of the user's own, the library's own
kernels, three.js in a browser, and any program that speaks a small protocol.
"""

from mipbake.fitting.fitting import fit
from mipbake.fitting.loop import Progress
from mipbake.fitting.program import Frame
from mipbake.fitting.renderer import Levels, Renderer
from mipbake.fitting.views import SCALES, View, standard_views

__all__ = ["SCALES", "Frame", "Levels", "Progress", "Renderer", "View", "fit", "standard_views"]
