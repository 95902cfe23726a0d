"""The paper's tables and figures, and the side-by-side with peers."""
