"""What a trained model is: encoder and decoder, whitening, released weights and their cards.

Importing this package or its registry imports neither torch nor NumPy, so that weights can be listed quickly.
"""

from mipbake.models.registry import WeightsInfo, default_weights, find_weights, list_weights, load_baker, load_network

__all__ = ["WeightsInfo", "default_weights", "find_weights", "list_weights", "load_baker", "load_network"]
