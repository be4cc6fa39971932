"""Servo designs on an independent plant: `python -m benchmarks.studies.servo_moves`.

The built-in arm with 5 kg and drawn arms, all with three-slope gears, are identified from logs that
MuJoCo simulated, and `tune` designs their servos for the identified parameters. MuJoCo then moves
the true arm, with friction, quantised encoders, the voltage limit and the delay. Printed are

- moves of single joints: steps under the current servo and under the designed loops (a plain PI
  cascade), the step through the recommended shaper, the step with feedback of the observed torsion,
  and the planned move with feed-forward;
- the tracking error of the links on a longer motion of all joints;
- margins measured by a sweep: sines are added to the voltage of one motor while it turns, and the
  loop is the ratio of the servo's answer to the voltage. Predicted are those of the estimates.

The page `build/servo-moves.html` has the same tables with plots.
"""
