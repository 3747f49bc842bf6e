"""One agent's learner, without bus, logs and environments.

`Learner` (learner.py) is what a service, an analysis and a test drive. It puts together an
algorithm (`otc_dist.algorithms`), a sampler (`otc_dist.otc`) and the agent's data: `Experience`
holds the data, `Trainer` makes the updates, `Fits` fits what distances need to B_0, and `Learned`
is all that a checkpoint keeps. `Actor` turns what was learned into actions; `Policy` is that
without the rest.
"""
