"""Whether errors are as large as their claimed covariance says."""

from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.uncertainty.noise import covariance_matrix


def consistency(errors: Any, covariance: Any) -> float:
    """Chance that errors deviate so far if the covariance is right.

    The sum of e' P^-1 e over N independent errors e, Gaussian with mean 0 and covariance P, has
    the chi-square distribution with n N degrees of freedom. Returned is the two-sided tail
    probability (p-value) of the sum that was found: rejecting below alpha is a false alarm with
    probability alpha. Errors too small count as much as errors too large.

    Parameters
    ----------
    errors : array, shape (n,) or (n, N)
        One error, or N independent ones. State errors of a filter make the test of its NEES,
        innovations of its NIS, deviations of samples from a known mean a test of their variance.
    covariance : float or array, shape (n, n), symmetric and positive definite

    Returns
    -------
    float
        Between 0 and 1.

    Raises
    ------
    TypeError, ValueError
        The covariance is not one, is singular, or is of another size than the errors.

    References
    ----------
    Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*,
    section 5.4.

    Examples
    --------
    >>> errors = np.random.default_rng(1).normal(scale=2.0, size=(1, 1000))
    >>> consistency(errors, 4.0) > 1e-8, consistency(errors, 2.0) > 1e-8
    (True, False)
    """
    errors = _validate.real_array("errors", errors)
    if errors.ndim not in (1, 2) or errors.size == 0:
        raise ValueError(f"errors must have shape (n,) or (n, N), got {errors.shape}")
    P = covariance_matrix("covariance", covariance, len(errors))
    try:
        factor = np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        raise ValueError(
            "covariance must be positive definite here: an error without variance has no size"
            " to compare with; leave that component out"
        ) from None
    normalized = scipy.linalg.solve_triangular(factor, errors, lower=True)
    with np.errstate(over="ignore"):
        total = float(np.sum(normalized**2))
    tails = scipy.special.chdtr(errors.size, total), scipy.special.chdtrc(errors.size, total)
    return float(min(1.0, 2 * min(tails)))
