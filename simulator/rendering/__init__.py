"""The cameras' pictures: the land, the road's surface, the props next to the road, the sky."""
