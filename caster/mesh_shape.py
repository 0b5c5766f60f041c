"""What every shape made of triangles shares: it says which mesh, the rest follows."""

from caster.fields import Shape
from caster.kernels.triangles import Triangles
from caster.mesh import Mesh
from caster.placing import Rounding, triangles


class MeshShape(Shape):
    """Triangles; smooth unless `face_normals`, with normals of its own or generated ones (angle-weighted)."""

    face_normals: bool = False

    def mesh(self) -> Mesh:
        """The triangles in object space."""
        raise NotImplementedError  # every subclass in the registry has one (tests/unit/test_registries.py)

    def pack(self, rounded: Rounding) -> Triangles:
        return triangles(self.mesh(), self.matrix, rounded, self.face_normals)
