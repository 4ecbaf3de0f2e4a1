"""The parts of docs/results.md: reading the files of benchmarks/results.py, tables, comparisons, charts."""
