"""The page of a comparison: one file that opens from disk without a network, its figures as JSON, its images as files.

Nothing on it is loaded from elsewhere: pictures, styles, scripts and the interactive view lie in the page. Without
scripts everything that was measured is still to be seen; they add the view, the motion of films and what reacts to a
pointer.
"""

from __future__ import annotations

from mipbake.comparing.page.writing import check_preview, check_report, write_report

__all__ = ["check_preview", "check_report", "write_report"]
