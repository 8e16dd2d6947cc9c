# SPDX-License-Identifier: Apache-2.0
"""Checks tools/examples/fleet/kubernetes.yaml against the API batch/v1 of Kubernetes and the exit
codes of relidar. Prints the shell script of its container.

   kubernetes_job.py KUBERNETES.YAML
"""
import sys

import yaml
from checks import expect


documents = {d["kind"]: d for d in yaml.safe_load_all(open(sys.argv[1])) if d}
expect(set(documents) == {"PersistentVolumeClaim", "Job"}, f"kinds {sorted(documents)}")
job = documents["Job"]
expect(job["apiVersion"] == "batch/v1", "apiVersion of the job")
spec, pod = job["spec"], job["spec"]["template"]["spec"]
known = {"completionMode", "completions", "parallelism", "backoffLimitPerIndex", "maxFailedIndexes", "podFailurePolicy", "template"}
expect(set(spec) <= known, f"keys {sorted(set(spec) - known)} of the job")
expect(spec["completionMode"] == "Indexed", "backoffLimitPerIndex and JOB_COMPLETION_INDEX need an indexed job")
expect(pod["restartPolicy"] == "Never", "podFailurePolicy needs restartPolicy Never")
expect(spec["maxFailedIndexes"] <= spec["completions"], "maxFailedIndexes above completions")

(container,) = pod["containers"]
expect(container["command"] == ["sh", "-c"] and len(container["args"]) == 1, "command is not a shell with one script")
volumes = {v["name"]: v for v in pod["volumes"]}
mounts = {m["mountPath"]: volumes[m["name"]] for m in container["volumeMounts"]}
claims = [v["persistentVolumeClaim"]["claimName"] for v in mounts.values()]
expect(claims == [documents["PersistentVolumeClaim"]["metadata"]["name"]], f"claims {claims}")
expect(list(mounts) == ["/fleet"], f"mounts {list(mounts)}")

actions = {}
for rule in spec["podFailurePolicy"]["rules"]:
    expect(("onExitCodes" in rule) != ("onPodConditions" in rule), f"a rule has exit codes or conditions, not both: {rule}")
    if "onExitCodes" in rule:
        expect(rule["onExitCodes"]["containerName"] == container["name"] and rule["onExitCodes"]["operator"] == "In", f"{rule}")
        actions.update({code: rule["action"] for code in rule["onExitCodes"]["values"]})
    else:
        expect(rule["action"] == "Ignore" and [c["type"] for c in rule["onPodConditions"]] == ["DisruptionTarget"], f"{rule}")
# Errors of usage and data would occur again, so they end the job. An interruption is not
# a failure. All remaining codes (1 bug, 4 device, 137 killed) count as a try.
expect(actions == {2: "FailIndex", 3: "FailIndex", 130: "Ignore"}, f"exit codes {actions}")
print(container["args"][0])
