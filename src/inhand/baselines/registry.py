"""The methods by name."""

from inhand.baselines.estimators import Estimator, ablation
from inhand.baselines.super4pcs import Super4PCS
from inhand.baselines.open3d_features import *
from inhand.baselines.opencv_ppf import *
from inhand.baselines.kiss_matcher import *
from inhand.baselines.registration import CloudMethod
from inhand.config import EstimatorConfig


def find_method(name, seed=0):
    if name == "inhand":
        return Estimator(name, EstimatorConfig())
    if name.startswith("ablation"):
        return Estimator(name, ablation()[name])
    n = name.split("+")[0]
    icp = name.endswith("+icp") or n != "super4pcs"
    source = "hs" if "+hs" in name else "mask" if "+mask" in name else "region"
    return CloudMethod(
        name,
        {
            "super4pcs": Super4PCS,
            "fpfh-ransac": FpfhRansac,
            "fgr": FastGlobalRegistration,
            "opencv-ppf": OpenCVPpf,
            "kiss-matcher": KissMatcher,
        }[n],
        source,
        icp,
    )
