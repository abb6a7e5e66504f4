"""Stub."""
from dataclasses import dataclass
import trimesh
@dataclass
class Visual:
    mesh: str; material: str; xyz: tuple = (0,0,0); rpy_deg: tuple = (0,0,0)
MATERIALS = {"aluminium": (0.75,0.77,0.8,1)}
VISUALS = {}
def build_meshes(): return {}
def stl_bytes(m): return m.export(file_type="stl")
