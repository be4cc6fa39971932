"""How well a fit names what its model lacks: `python -m benchmarks.studies.causes --arms 200`.

Arms are drawn over the gear catalogue, horizontal and upright. Each has one cause that its study
does not mention, of a drawn size at a drawn joint, or with `--clean` none. Its logs come from the
project's own plant or from MuJoCo, where a cause is written a second time, and go through the whole
of `identify`: as they are, with the cause named in the study where a study can name it, and with
`--auto` with effects that the fit selects.

A parameter is *sound* within 1 % of the truth (gear damping 5 %) or where its 95 % interval holds
the truth. A cause *matters* where ignoring it costs a primary parameter: one that is sound of the
same arm with the same noise and no cause is not sound, or not given.
"""
