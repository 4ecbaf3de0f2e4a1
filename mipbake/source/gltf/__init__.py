"""glTF 2.0 files: the materials in them that can be baked, and the same files with baked textures.

The JSON stays as it was parsed, so that what this package does not know passes through untouched.
"""
