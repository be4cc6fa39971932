"""The arm's forward models over the compiled core: simulation, regressor, torques, sensors."""
