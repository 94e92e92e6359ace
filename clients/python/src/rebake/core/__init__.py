"""What a client of rebake knows, without input and output: requests are built, answers are read, and whatever takes
more than one of them is a generator of steps (:mod:`.steps`) that a driver carries out. Needs NumPy and nothing else,
so that programs with an interpreter of their own (Blender) can bring it along.
"""
