"""Checking, editing, recovering and copying logs."""
