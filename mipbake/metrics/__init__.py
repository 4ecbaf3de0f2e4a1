"""What is measured: light-view pair sets and the error measures over them."""

from mipbake.metrics.pairs import PAIR_SETS, LightViewPairs, pair_set
from mipbake.metrics.snr import snr_db

__all__ = ["PAIR_SETS", "LightViewPairs", "pair_set", "snr_db"]
