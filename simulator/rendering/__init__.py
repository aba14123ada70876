"""The cameras' pictures: the land, the road's surface, what stands beside it, the sky."""
