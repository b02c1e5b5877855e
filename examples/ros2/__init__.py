"""Messages of our own for ROS 2: `tilth_msgs` goes into the `src` of a workspace there."""
