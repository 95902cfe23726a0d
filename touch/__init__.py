"""Where taxel values come from: contact simulator, objects, trajectories, recordings."""
