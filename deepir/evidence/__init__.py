"""Strengths from the data: how likely are they, whatever gain, offset and scene may be?"""
