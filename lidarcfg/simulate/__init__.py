"""What a rig's sensors report in a scene."""
