"""Measurements on many drawn arms, each behind tables of the documentation.

Run one with `python -m benchmarks.studies.NAME`; the page next to it has the numbers.

| study | measures | page |
|---|---|---|
| lab | errors of every stage on logs of known arms | docs/benchmarks.md |
| measured | parameters and predictions of measured machines | docs/benchmarks.md |
| engine | errors on drawn arms simulated in MuJoCo | README, docs/benchmarks.md |
| coverage | coverage of 95 % intervals, also over a gear catalogue | docs/benchmarks.md |
| sensors | errors and coverage with few or mixed sensors | README, docs/benchmarks.md |
| causes | likely effects named and included by "auto" on drawn arms | docs/benchmarks.md |
| mutated | refusals of randomly changed studies | docs/benchmarks.md |
| agreement | differences between rigid and whole-arm values on altered logs | docs/benchmarks.md |
| faults | input faults named on drawn arms | docs/benchmarks.md |
| short_motions | false suspicions on arms without a fault | docs/benchmarks.md |
| hygiene | sensor defects named in logs | docs/benchmarks.md |
| visits | differences between two visits reported by `compare` | docs/compare.md |
| serial_rigid | torque fits and base parameters on measured serial arms | docs/benchmarks.md |
| small_arm | writes tests/data/small-arm | tests/data/small-arm/README.md |

`arms` draws the arms and runs a function on each in a pool of processes.
"""
