"""The stages: rigid arm, decoupled joints, joint models, the whole arm, validation."""
