"""The cameras' pictures: the land, the road's surface, the props beside the road, the sky."""
