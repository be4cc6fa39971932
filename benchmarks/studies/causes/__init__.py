"""Naming of unmodelled effects: `python -m benchmarks.studies.causes --arms 200`.

Arms are drawn over the gear catalogue, horizontal and vertical. Each has one cause, an effect that
its study does not name, of drawn size at a drawn joint (with `--clean` none). Logs come from
strainwave's simulator or from MuJoCo, where causes are implemented independently. `identify` runs
without the effect, with the effect in the study if a study can name it, and with `--auto` with
effects that the fit selects.

A parameter is *accurate* within 1 % of the true value (gear damping 5 %) or if its 95 % interval
contains it. A cause *matters* if a primary parameter is inaccurate or not identified that is
accurate for the same arm with the same noise and no cause.
"""
