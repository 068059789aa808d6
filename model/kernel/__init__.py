"""The kernel on the direct sum x ⊕ f and the RKHS it spans."""

from model.kernel.feature_kernel import FEATURE_KERNELS, FeatureKernel, feature_kernel
from model.kernel.rkhs import InnerProducts, KernelTerms, RkhsKernel, squared_distances

__all__ = [
    "FEATURE_KERNELS",
    "FeatureKernel",
    "InnerProducts",
    "KernelTerms",
    "RkhsKernel",
    "feature_kernel",
    "squared_distances",
]
