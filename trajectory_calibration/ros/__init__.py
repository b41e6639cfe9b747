"""The node: rclpy alone; everything that can be tested without ROS is in ``online``."""
