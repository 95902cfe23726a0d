"""A skin on ROS 2's wire: topics and a service as rmw_zenoh has them, without ROS, and bags."""
