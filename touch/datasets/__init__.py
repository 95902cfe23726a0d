"""The paper's two data sets on disk: trajectories to rebuild, and observations to classify."""
