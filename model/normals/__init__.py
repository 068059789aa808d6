"""Learned normals: which neighbours tell how the surface faces."""

from model.normals.compiled_network import CompiledNormals
from model.normals.network import NormalNetwork

__all__ = ["CompiledNormals", "NormalNetwork"]
