"""The balanced samples that training uses: choose and label them from the frames, write them, and read them."""
