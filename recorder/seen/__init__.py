"""What pictures show: turning, the steering's lag, side cameras."""
