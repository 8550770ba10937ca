"""Choice of lights from images of samples, without a model of part or rig."""
