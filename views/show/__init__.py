"""A skin in other programs' views: Rerun and Foxglove."""
