"""The arm: joints, kinds, gear laws, effects, link sensors and parameters."""
