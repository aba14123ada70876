"""docs/kuberay-cluster.yaml is what KubeRay takes: of the fields that it has, with values of their types.

The schema is written by hand, of the fields that the example uses: KubeRay's own has 900 KB, most of it of pods in
general. The names and types are those of helm-chart/kuberay-operator/crds/ray.io_rayclusters.yaml (version v1) of
https://github.com/ray-project/kuberay at commit 017710c025a86af5225c0e68cd78fb06e2918296, after 1.5.1;
those of pods are Kubernetes' core/v1.
"""

from __future__ import annotations

import copy
import re
from typing import Any

import jsonschema
import pytest
import yaml

from repository import ROOT

TEXT = {"type": "string"}
COUNT = {"type": "integer", "minimum": 0, "maximum": 2**31 - 1}
TEXTS = {"type": "object", "additionalProperties": TEXT}
QUANTITIES = {
    "type": "object",
    "additionalProperties": {"type": "string", "pattern": r"^[0-9]+(\.[0-9]+)?([KMGTPE]i|[numkMGTPE])?$"},
}


def fields(required: str, **types: Any) -> dict[str, Any]:
    """An object with these fields and no others: Kubernetes leaves out what it does not know."""
    return {"type": "object", "properties": types, "required": required.split(), "additionalProperties": False}


def several(kind: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": kind, "minItems": 1}


CONTAINER = fields(
    "name image",
    name=TEXT,
    image=TEXT,
    workingDir=TEXT,
    env=several(fields("name", name=TEXT, value=TEXT)),
    resources=fields("", limits=QUANTITIES, requests=QUANTITIES),
    volumeMounts=several(fields("name mountPath", name=TEXT, mountPath=TEXT)),
)
VOLUME = fields("name", name=TEXT, persistentVolumeClaim=fields("claimName", claimName=TEXT))
POD = fields(
    "spec", spec=fields("containers", containers=several(CONTAINER), volumes=several(VOLUME)), metadata=TEXTS
)
RAY_CLUSTER = fields(
    "apiVersion kind metadata spec",
    apiVersion={"const": "ray.io/v1"},
    kind={"const": "RayCluster"},
    metadata=fields("name", name=TEXT),
    spec=fields(
        "headGroupSpec",
        rayVersion=TEXT,
        authOptions=fields("", mode={"enum": ["disabled", "token"]}, enableK8sTokenAuth={"type": "boolean"}),
        enableInTreeAutoscaling={"type": "boolean"},
        autoscalerOptions=fields("", idleTimeoutSeconds=COUNT),
        headGroupSpec=fields(
            "template rayStartParams", serviceType={"enum": ["ClusterIP"]}, rayStartParams=TEXTS, template=POD
        ),
        workerGroupSpecs=several(
            fields(
                "groupName minReplicas maxReplicas rayStartParams template",
                groupName=TEXT,
                replicas=COUNT,
                minReplicas=COUNT,
                maxReplicas=COUNT,
                rayStartParams=TEXTS,
                template=POD,
            )
        ),
    ),
)


def test_the_example_for_kuberay_has_its_fields_and_one_disk_for_all_pods() -> None:
    claim, cluster = yaml.safe_load_all((ROOT / "docs" / "kuberay-cluster.yaml").read_text())
    jsonschema.validate(cluster, RAY_CLUSTER)
    spec = cluster["spec"]
    assert spec["authOptions"] == {"mode": "token"}
    assert spec["headGroupSpec"]["rayStartParams"]["num-cpus"] == "0"
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]
    pods = [group["template"]["spec"] for group in (spec["headGroupSpec"], *spec["workerGroupSpecs"])]
    for pod in pods:
        assert pod["volumes"][0]["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
        assert pod["containers"][0]["volumeMounts"] == [
            {"name": pod["volumes"][0]["name"], "mountPath": "/shared"}
        ]
    misspelt = copy.deepcopy(cluster)
    misspelt["spec"]["workerGroupSpecs"][0]["maxReplica"] = 4
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(misspelt, RAY_CLUSTER)


def test_the_pages_image_has_the_ray_of_the_constraints() -> None:
    pinned = re.search(r"^ray==(.+)$", (ROOT / "constraints.txt").read_text(), re.M)
    assert pinned is not None
    _, cluster = yaml.safe_load_all((ROOT / "docs" / "kuberay-cluster.yaml").read_text())
    assert cluster["spec"]["rayVersion"] == pinned[1]
    assert f"FROM rayproject/ray:{pinned[1]}-py" in (ROOT / "docs" / "scale.md").read_text()
