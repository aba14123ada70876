"""The folders of a project as the pages show them: listed, summed up, cached; no web in it."""
