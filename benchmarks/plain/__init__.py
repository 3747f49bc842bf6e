"""The algorithms as they are usually written in torch: what ours must equal, and the peers that it
is timed against.

Modules, autograd, torch.optim.Adam, one operation after another, as in single-file
implementations such as CORL's, written from the published equations. Sizes and rates come from
the same sections as ours; nothing else here is shared with the library. The tests make hundred
updates in float64 with noise of their own (tests/algorithms), the benchmarks let each update draw
its own minibatch and noise (`parts.Training`).

States are standardised beforehand where an algorithm wants that (`standardised`).
"""
