"""
Tracks by halves of the receivers
=================================

`maloc.plots.halves`: the difference of two tracks of one animal, each by half of the receivers,
over its stated standard deviation. Nineteen of twenty points lie in the band where the tracks'
intervals are honest.
"""

import small_study

import maloc


def by_half(part):
    """Fit the track by the receivers of one half."""
    return maloc.infer.laplace(maloc.models.toa_track, part)


found = maloc.evaluate.halves(small_study.arrivals(), by_half, least=3)
maloc.plots.halves(found)
