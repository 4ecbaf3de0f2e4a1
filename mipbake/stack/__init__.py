"""A finished MIP stack: what it holds, its files and containers, presets, packing, and what the files cost."""
