"""Checks of a rig and a part before anything is rendered: findings with numbers and advice."""

from ._check import check_rig, check_scene
