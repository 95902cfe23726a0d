"""What shows a skin to people and programs: the page, ROS 2, Rerun and Foxglove."""
