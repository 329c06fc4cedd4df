# SPDX-License-Identifier: MIT
"""Rejection of uncertain labels, by a limit or by the threshold of `tune risk`."""

import logging
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.engines.device import arithmetic_in, is_int8
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.labelling import LabelledScan
from salsanext_cli.core.measures.risk_control import guarantee_text
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.core.wording import argument, command, setting, share
from salsanext_cli.runs.fit.threshold_settings import label_settings, setting_as_typed
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import PredictSettings

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelRejection:
    """Rule by which labels are rejected."""

    kind: str  # Kind of uncertainty: error or least_confidence
    threshold: float  # Largest uncertainty of an accepted point
    risk: RiskThreshold | None  # Origin of the threshold

    def recorded_in(self, settings: PredictSettings) -> PredictSettings:
        """Return settings with the rule; the accuracy of accepted labels cannot be estimated."""
        return replace(
            settings,
            reject=self.threshold,
            reject_by=None if self.kind == "error" else self.kind,
            guarantee=self.risk,
            accuracy=None,
        )

    def rejected(self, uncertainty: Float) -> Mask:
        """Return which labels are rejected, (N,), by the uncertainty of the points, (N,) float32.

        Points without an uncertainty, NaN, are not rejected.
        """
        return uncertainty > np.float32(self.threshold)

    def applied(self, scan: LabelledScan, uncertainty: Float) -> LabelledScan:
        """Return a scan whose rejected labels are 0, by the uncertainty of its points, (N,)."""
        labels = np.where(self.rejected(uncertainty), np.uint8(0), scan.labels)
        return replace(scan, labels=labels)


def label_rejection(
    reject: float | str, settings: NetworkSettings, network: Network, knn: KnnParameters
) -> LabelRejection:
    """Return the rule of a run that rejects labels.

    Parameters
    ----------
    reject : float or "risk"
        Largest probability of error of an accepted point, or the threshold in the weights.
    settings : NetworkSettings
        Settings of the run, whose labels the guarantee of a threshold has to cover.
    network : Network
        Network of the run.
    knn : KnnParameters
        Neighbourhood of the vote of the run.

    Returns
    -------
    LabelRejection

    Raises
    ------
    SalsanextError
        If the value is no probability, or the weights have no threshold for such labels.
    """
    if reject == "risk":
        risk = _threshold_of_weights(settings, network, knn)
        return LabelRejection(kind=risk.kind, threshold=risk.threshold, risk=risk)
    if isinstance(reject, str) or not 0 <= reject <= 1:
        raise UsageError(argument("reject"), str(reject), "a probability from 0 to 1")
    return LabelRejection(kind="error", threshold=reject, risk=None)


def _threshold_of_weights(
    settings: NetworkSettings, network: Network, knn: KnnParameters
) -> RiskThreshold:
    """Return the threshold in the weights; refuse settings that its guarantee does not cover."""
    risk = network.card.risk
    if risk is None:
        raise _no_threshold(settings, network)
    changed = _changed_settings(risk, settings, network, knn)
    if changed:
        raise _not_covered(changed[0], risk, settings, network)
    log.log(NOTICE, "%s: %s", setting("reject", "risk"), guarantee_text(risk))
    return risk


def _no_threshold(settings: NetworkSettings, network: Network) -> WeightsError:
    """Return the error about weights without a threshold, with the command that chooses one."""
    options = [share("at_most", 0.05)]
    if settings.width:
        options.append(setting("width", settings.width))
    tune = command("salsanext tune risk DATASET WEIGHTS_OUT", *options)
    problem = "has no threshold of risk"
    parts_of_widths = network.card.parts_of_widths
    others = sorted(width for width, parts in parts_of_widths.items() if parts.risk)
    if others:
        columns = ", ".join(map(str, others))
        problem += f" for images of {network.sensor.width} columns, only for {columns}"
    return WeightsError(network.backend.name, problem, hint=f"choose one with `{tune}`")


def _changed_settings(
    risk: RiskThreshold, settings: NetworkSettings, network: Network, knn: KnnParameters
) -> list[str]:
    """Return the names of the settings that differ from the settings of the threshold."""
    current = label_settings(settings, network)
    is_changed = {"classes": network.merging is not None, "knn": knn != KnnParameters()}
    for name, key in KEY_OF.items():
        is_changed[name] = current[key] != risk.settings.get(key)
    return [name for name, changed in is_changed.items() if changed]


def _not_covered(
    name: str, risk: RiskThreshold, settings: NetworkSettings, network: Network
) -> UsageError:
    """Return the error about a setting by which a guarantee does not cover the labels."""
    problem = f"the guarantee of `{setting('reject', 'risk')}` does not cover other labels"
    if name not in KEY_OF:
        return UsageError(argument(name), problem, hint=f"omit {argument(name)}")
    hint = "use the option as for `tune risk`, or run `tune risk` again"
    if name != "sensor":
        key = KEY_OF[name]
        tuned = setting_as_typed(name, risk.settings.get(key))
        current = setting_as_typed(name, label_settings(settings, network).get(key))
        problem = f"the threshold was chosen with {tuned}, this run has {current}"
        if is_int8(tuned) and is_int8(current):
            cpus = f"a CPU with {arithmetic_in(tuned)}, this one has {arithmetic_in(current)}"
            problem = f"the threshold was chosen in int8 on {cpus}"
            hint = "predict on a CPU of that kind, or run `tune risk` again on this one"
    return UsageError(argument(name), problem, hint=hint)
