"""The paper's two data sets on disk: trajectories for reconstruction, observations for classification."""
