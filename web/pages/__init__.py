"""The pages: each module has the addresses of one page, and their responses."""
