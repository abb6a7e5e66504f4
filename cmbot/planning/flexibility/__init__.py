"""What bends while a motion is planned: how it sways along a leg, and sag compensation."""
