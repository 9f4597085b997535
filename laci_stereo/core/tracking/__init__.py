"""From point clouds to tracks of moving objects: background, clusters, boxes, sightings, tracks."""
