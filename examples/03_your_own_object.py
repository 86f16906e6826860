"""Your own object: its unit, its frame, its symmetry.

`python 03_your_own_object.py part.stl mm` reads your mesh; without it, a cup is made, in
millimetres, as CAD programs export it.
"""

import sys

import numpy as np
import trimesh

import inhand

path, unit = sys.argv[1:] if len(sys.argv) == 3 else ("cup.stl", "mm")
if len(sys.argv) != 3:
    profile = [(0, 0), (27, 0), (36, 90), (33, 90), (25, 3), (0, 3)]  # radius and height [mm]
    trimesh.creation.revolve(profile, sections=96).export(path)

# A forgotten unit is an error that says which one it probably is.
try:
    inhand.ObjectModel.from_mesh(path)
except inhand.InputError as error:
    print("without a unit:", error)

obj = inhand.ObjectModel.from_mesh(path, unit=unit)
print(f"diameter {1000 * obj.diameter:.1f} mm")
print("corners of its box, in the frame of the mesh [m]:", obj.mesh.bounds.round(4).tolist())

# Turns that leave the shape as it is are found from the mesh.
symmetry = obj.symmetry
print("axis:", None if symmetry.axis is None else symmetry.axis.round(3).tolist())
print("rotations onto itself:", len(symmetry.rotations))  # with an axis: and any angle about it

# The estimate is one of the poses that look alike. Take the one that suits you: the least turned.
T_camera_object = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0.4], [0, 0, 0, 1.0]])
alike = T_camera_object @ symmetry.representatives(steps=360)
least_turned = alike[np.argmax(np.trace(alike[:, :3, :3], axis1=1, axis2=2))]
print(least_turned.round(3))

# Where a print tells poses apart that the shape does not, or for a symmetry of your own:
told_apart = inhand.ObjectModel.from_mesh(path, unit=unit, symmetry="none")
half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
own = inhand.Symmetry(np.zeros(3), axis=None, rotations=np.stack([np.eye(4), half_turn]))
two_fold = inhand.ObjectModel.from_mesh(path, unit=unit, symmetry=own)
print("rotations:", len(told_apart.symmetry.rotations), "and", len(two_fold.symmetry.rotations))
