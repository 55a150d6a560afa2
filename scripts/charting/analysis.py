"""What the chart reads from measured points: the Pareto front, a reference's own error, the cheapest at an error."""
import math


def pareto(points):
    """Indices of the (time, error) pairs that no other one beats in both, by increasing time."""
    front, best = [], math.inf
    for index in sorted(range(len(points)), key=lambda k: points[k]):
        if points[index][1] < best:
            front.append(index)
            best = points[index][1]
    return front


def own_error(sizes, distances):
    """
    The error of a finest solution from its distance to two coarser ones (Richardson). `sizes`: h of the coarse, the
    middle and the finest solution (or their time steps), `distances`: of the coarse and the middle one from the
    finest. The error is C h^p, so that the distances are C (h_k^p - h_finest^p). Returns the order p, at most 4, and
    the error; where the distances tell of no order, None and the larger distance.
    """
    coarse, middle, fine = sizes
    if not coarse > middle > fine > 0 or min(distances) < 0:
        raise ValueError(f"sizes {sizes} must decrease and distances {distances} must not be negative")

    def ratio(p):
        return (coarse**p - fine**p) / (middle**p - fine**p)

    low, high = 1e-6, 4.0  # the ratio grows with p
    if distances[0] <= ratio(low) * distances[1]:
        return None, max(distances)
    for _ in range(60):
        p = (low + high) / 2
        low, high = (p, high) if ratio(p) * distances[1] < distances[0] else (low, p)
    return high, distances[1] * fine**high / (middle**high - fine**high)


def cheapest(points, error):
    """Index of the fastest (time, error) pair of at most this error, or None."""
    good = [k for k, (_, reached) in enumerate(points) if reached <= error]
    return min(good, key=lambda k: points[k][0]) if good else None

