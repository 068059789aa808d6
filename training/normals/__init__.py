"""Training the network that corrects normals, on shapes whose normals are known."""
