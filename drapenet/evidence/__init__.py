"""What is known of a fabric: one prior, any number of sources, one way to combine them.

The state of a cloth (:mod:`drapenet.evidence.state`) has a prior. Captures through the network
give samples of its posterior; refined captures, strips and values of testers are sources
(:mod:`drapenet.evidence.source`), which :mod:`drapenet.evidence.combine` adds to samples and tests
for contradictions. A value of a new kind is a quantity of :mod:`data.readings`.
"""
