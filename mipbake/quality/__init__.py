"""How good a stack is: the filtered reference, measures, the judge, and the lookups of a sampler."""
