# SPDX-License-Identifier: Apache-2.0
"""Learning beyond the compiled EM of full covariances: structures, encodings, model choice.

Modules are imported by name; this file imports nothing, so that `tpgmm_core.learning.tpgmm` can use some of them and
others can use it.
"""
