"""The launch description: everything a run depends on."""

from otc_dist.description.algorithms import AlgorithmSection as AlgorithmSection
from otc_dist.description.description import Description as Description
from otc_dist.description.description import progress as progress
from otc_dist.description.sampling import SamplingSection as SamplingSection
from otc_dist.description.sections import DeploymentSection as DeploymentSection
from otc_dist.description.sections import DynamicsSection as DynamicsSection
from otc_dist.description.sections import EmbeddingSection as EmbeddingSection
from otc_dist.description.sections import EngineName as EngineName
