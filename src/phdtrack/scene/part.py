"""Births or false alarms that follow the scene: density, rate, and whether to believe them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from phdtrack.scene.density import ContextDensity, uniform_density
from phdtrack.scene.evidence import Evidence
from phdtrack.scene.learner import LEAST_UNIFORM
from phdtrack.scene.recent import OLDEST, Recent, relearned, thinned
from phdtrack.scene.scene_file import Learned
from phdtrack.types import F8

# Samples over which the evidence fades at least, and parts of the memory.
_LASTING, _PART = 30.0, 1 / 20
# Samples kept of a batch.
MOST = 12
# What a new mode takes over of the one that it leaves.
_FORKED = 0.2
# Samples at most that stand for what was learned before.
_PRIOR = 400


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Samples (d, k) of the last seconds, their ``weight`` (k,), and the ``exposure`` in which they came.

    The exposure is in what rates are per: time units for births, frames for false alarms; ``rate`` of it make a second.
    """

    samples: F8
    weight: F8
    exposure: float
    rate: float


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """What is known of births, or of false alarms.

    Attributes
    ----------
    density : what was learned; the uniform one at first.     recent : of what.
    amount, exposure : samples and the time in which they came, both fading: their ratio is the rate.
    evidence : for the density against another one, of the last samples; ``usual`` : of those of the memory; ``newest`` : of
        the last batch.
    trusted : whether it is in use.
    """

    density: ContextDensity
    recent: Recent
    amount: float = 0.0
    exposure: float = 0.0
    evidence: Evidence = field(default_factory=Evidence)
    usual: Evidence = field(default_factory=Evidence)
    newest: Evidence = field(default_factory=Evidence)
    trusted: bool = False

    @classmethod
    def unknown(cls, low: F8, high: F8) -> Part:
        """Nothing learned of a volume."""
        return cls(uniform_density(low, high), Recent.empty(len(low)))

    @classmethod
    def of(cls, learned: Learned, memory: float, rate: float) -> Part:
        """What was learned before, as if it had come within the ``memory`` (s) before now; ``rate`` as of `Batch`.

        Draws of its Gaussians stand for the samples: the uniform part is mostly what nobody has seen (`context.prior`).
        """
        count = max(1, min(_PRIOR, learned.samples))
        seen = replace(learned.density, uniform=LEAST_UNIFORM) if len(learned.density) else learned.density
        drawn = seen.sample(count, np.random.default_rng(0))
        amount = learned.rate * memory * rate
        recent = Recent(drawn, np.full(count, amount / count), np.zeros(count))
        return cls(learned.density, recent, amount, memory * rate, trusted=True)

    @property
    def rate(self) -> float:
        """s̄ or r̄, 0 before anything was seen."""
        return self.amount / self.exposure if self.exposure > 0 else 0.0

    def asked(self, batch: Batch, memory: float, gain: Callable[[F8], F8] | None = None) -> Part:
        """With the evidence of a batch that it has not learned.

        ``gain`` tells by how many nats samples (d, k) are likelier than under another density; None: the uniform one.
        """
        inside = self.density.contains(batch.samples)
        samples, weight = batch.samples[:, inside], batch.weight[inside]
        ahead = self.above_uniform(samples) if gain is None else gain(samples)
        lasting = memory * batch.rate * self.rate
        return replace(
            self,
            evidence=self.evidence.seen(ahead, weight, max(_LASTING, _PART * lasting)),
            usual=self.usual.seen(ahead, weight, max(_LASTING, lasting)),
            newest=Evidence().seen(ahead, weight, math.inf),
        )

    def above_uniform(self, samples: F8) -> F8:
        """(k,) nats by which samples (d, k) inside the volume are likelier than under the uniform density over it."""
        out: F8 = self.density.log(samples) + math.log(self.density.volume)
        return out

    def forked(self) -> Part:
        """The same, worth a fifth of what it was, and with nothing said for it yet."""
        recent = Recent(self.recent.samples, _FORKED * self.recent.weight, np.minimum(self.recent.time, 0.0))
        amount, exposure = _FORKED * self.amount, _FORKED * self.exposure
        return Part(self.density, recent, amount, exposure, trusted=self.trusted)

    def judged(self) -> Part:
        """In use where the evidence is for it, out of use where that, or the last batch, is against it; else as it was."""
        against = self.evidence.against_it or self.newest.against_it
        return replace(self, trusted=not against and (self.trusted or self.evidence.for_it))

    def taught(self, batch: Batch, now: float, memory: float) -> Part:
        """After learning from a batch at ``now`` seconds, with forgetting."""
        fade = math.exp(-batch.exposure / (batch.rate * memory))
        amount, exposure = fade * self.amount + float(batch.weight.sum()), fade * self.exposure + batch.exposure
        inside = self.density.contains(batch.samples) & (batch.weight > 0)
        samples, weight = thinned(batch.samples[:, inside], batch.weight[inside], MOST)
        if not len(weight):
            return replace(self, amount=amount, exposure=exposure)
        kept = self.recent.take(self.recent.time > now - OLDEST * memory)
        recent = kept.joined(Recent(samples, weight, np.full(len(weight), now)))
        density = relearned(self.density, recent, now, memory)
        return replace(self, density=density, recent=recent, amount=amount, exposure=exposure)
