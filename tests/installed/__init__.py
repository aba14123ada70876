"""Tests of the wheel as its users install it: `make test-installed`."""
