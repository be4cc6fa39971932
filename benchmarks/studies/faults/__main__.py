"""Faults on drawn arms: `python -m benchmarks.studies.faults`."""

from benchmarks.studies.faults.drawn import main

main()  # processes import the tasks by the name of their module, which `__main__` is not
