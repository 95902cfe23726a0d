"""Sources of forces on taxels: contact simulator, objects, trajectories, recordings, data sets."""
