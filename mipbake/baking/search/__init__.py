"""Methods that search: blends of what other methods make, and descent on texels."""
