"""The web server: who may ask it, how it starts and stops, templates, and what an error looks like."""
