"""The peers of the benchmarks: algorithms as they are usually written in torch.

Modules, autograd, torch.optim.Adam, one operation after another; each update draws its own
minibatch and noise, gathers field by field, and reads its losses back, as single-file
implementations such as CORL's do. Sizes and rates come from the same sections as ours. Nothing
here is shared with the library.
"""
