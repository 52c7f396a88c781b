# SPDX-License-Identifier: Apache-2.0
"""Learning: estimators, and in folders what they are made of (`covariance`, `estimation`) and what else there is
(`hidden_markov`, `incremental`).

Modules are imported by name.
"""
