"""The scenes whose steps are timed: bodies that fall under their weight from rest, their lowest twentieth held."""

# What the scenes of config/ do not say so; steps of 20 ms, Poisson's ratio 0.45 and 500 kg/m^3 they do
FALL = ["fixed=[{name: ground, box: {min: [-2, -2, -2], max: [2, 2, 0.05]}}]", "loads=[]", "material.young=2.0e+5",
        "solver.max_iterations=20000"]
CLASSIC = ["solver.preconditioner=block_jacobi", "solver.operator=assembled"]
BLOCKS = ["solver.preconditioner=block_jacobi"]
TOLERANCE = 1e-4

BUNNY_10000, ARMADILLO_10000 = "model.cell_size=0.047", "model.cell_size=0.0343"
# Name, scene of config/, overrides, products that a step may take
STEPS = [("bunny, about 3200", "bunny", [], 16),
         ("armadillo, about 1100", "armadillo", [], 22),
         ("bunny, about 10 000", "bunny", [BUNNY_10000], 16),
         ("armadillo, about 10 000", "armadillo", [ARMADILLO_10000], 24),
         ("bunny, about 3200, ν = 0.49", "bunny", ["material.poisson=0.49"], 30)]
CLASSIC_CLAIMED = "bunny, about 3200"  # what is claimed of CLASSIC is of that one; the others take FEW_STEPS
FEW_STEPS = 20
TWO_THREADS = 0.65  # of the time of one
REAL_TIME = 20      # ms a step

LINEAR_TOLERANCE = 1e-5
# Name, scene, overrides, times as fast as the diagonal blocks, and what is published for a body of this kind:
# FEMFX and VegaFEM, tets and ms a step on another machine, see page.py
LINEAR = [("bunny, about 10 000", "bunny", [BUNNY_10000], 5, {"tets": 10246, "FEMFX": 31, "VegaFEM": 143}),
          ("armadillo, about 10 000", "armadillo", [ARMADILLO_10000], 3.5,
           {"tets": 10809, "FEMFX": 45, "VegaFEM": 239})]

# The bunny, meshed ever finer, and cut into eight; steps at most
GROWTH = [("meshed", ["model.cell_size=0.11"], 60), ("meshed", [], 60), ("meshed", [BUNNY_10000], 60),
          ("meshed", ["model.cell_size=0.0318"], 60), ("cut", ["model.cell_size=0.11", "model.refine=1"], 60),
          ("cut", ["model.refine=1"], 60), ("meshed", ["model.cell_size=0.0208"], 5)]
GROWTH_FROM, GROWTH_TO, GROWTH_END = 1000, 30000, 100000  # tets, to the nearest mesh
ITERATIONS_GROW, TIME_GROWS = 1.5, 2

HUGE_PAGES = STEPS[0], STEPS[2]  # whose steps are timed with and without them

PRODUCT, ROTATIONS = 0.28, 0.2  # of a plain product in double
