# SPDX-License-Identifier: Apache-2.0
"""The composed launcher: the processes of a flight and how they are started."""
