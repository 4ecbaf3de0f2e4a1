"""The page docs/paper-figures.md: figures 3 to 11 of Kemppinen et al. 2023, made again, beside what the paper says."""
