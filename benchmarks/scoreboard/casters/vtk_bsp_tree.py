import numpy as np
import pyvista
import vtk


def trace(v, f, o, d, t_min, t_max):
    tree = vtk.vtkModifiedBSPTree()
    tree.SetDataSet(pyvista.PolyData.from_regular_faces(v.astype(np.float64), f))
    tree.BuildLocator()
    reach = 2 * np.linalg.norm(np.abs(v).max(axis=0) + np.abs(o), axis=1) / np.linalg.norm(d, axis=1)
    found, t = (vtk.reference(0.0), [0.0] * 3, [0.0] * 3, vtk.reference(0), vtk.reference(0)), np.full(len(o), np.inf)
    for i in range(len(o)):  # it takes segments, and returns the fraction of one
        if tree.IntersectWithLine(o[i], o[i] + reach[i] * d[i], 0.0, *found):
            t[i] = found[0].get() * reach[i]
    return t, None
