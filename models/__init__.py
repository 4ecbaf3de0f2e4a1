"""What a trained model is: encoder and decoder, whitening, released weights and their cards.

Importing it imports no torch, so that weights are listed quickly.
"""

from mipbake.models.registry import WeightsInfo, default_weights, find_weights, list_weights, load_baker, load_network

__all__ = ["WeightsInfo", "default_weights", "find_weights", "list_weights", "load_baker", "load_network"]
