"""The numbered claims of Ivanov and Shuvalov (2012), recomputed from the model."""

from curlfit.claims.record import Claim
from curlfit.claims.reproduction import ORDER, Reproduction, reproduce

__all__ = ["ORDER", "Claim", "Reproduction", "reproduce"]
