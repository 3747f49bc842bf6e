"""Pure steps, and what runs them: nothing here knows an algorithm.

To write an algorithm with: networks and Adam (networks.py), random arrays (noise.py), the state
(state.py). To run it: the loop (training.py) and the engine, which compiles a step, records it in a
CUDA graph, or runs it eagerly (engine.py). The other modules are what makes compiled code fast.
"""
