"""Speed, as ratios within one run: drive, environments, CANopen, training."""
