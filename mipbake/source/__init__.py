"""Finding, reading and writing maps: one file per concern, image libraries imported where they are used."""
