"""What the numbers of rows show: quality, odd stretches, how somebody steers."""
