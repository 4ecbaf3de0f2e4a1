"""Image files of all kinds, and texels as graphics cards hold them."""
