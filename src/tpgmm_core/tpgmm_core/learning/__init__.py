# SPDX-License-Identifier: Apache-2.0
"""Learning: estimators, and in folders what they are made of.

`covariance` and `estimation` serve all of them; `hidden_markov` and `incremental` hold further kinds of models.
Modules are imported by name.
"""
