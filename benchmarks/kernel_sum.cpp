// The peer of benchmarks/kernel_sum.py: a radial sum as one writes it by hand in C++, one thread per chunk of targets.
// Coordinates by column, so that the compiler turns the inner loop into vectors (libmvec's log and exp).
#include <cmath>
#include <cstddef>

namespace {

struct ThinPlateSpline {
    double operator()(double r2) const { return 0.5 * r2 * std::log(r2 + 1e-300); }
};
struct WendlandC2 {
    double inverse_radius;
    double operator()(double r2) const {
        const double xi = std::fmin(std::sqrt(r2) * inverse_radius, 1.0), inner = 1.0 - xi;
        return inner * inner * inner * inner * (4.0 * xi + 1.0);
    }
};
struct Gaussian {
    double inverse_radius;
    double operator()(double r2) const { return std::exp(-r2 * inverse_radius * inverse_radius); }
};
struct Multiquadric {
    double inverse_radius;
    double operator()(double r2) const { return std::sqrt(1.0 + r2 * inverse_radius * inverse_radius); }
};

// points (3, n), sources (3, s), weights (3, s), tail (4, 3), result (3, n); all by row
template <class Basis>
void sum(Basis basis, std::ptrdiff_t n, std::ptrdiff_t s, const double* points, const double* sources,
         const double* weights, const double* tail, double* result) {
#pragma omp parallel for schedule(static)
    for (std::ptrdiff_t i = 0; i < n; ++i) {
        const double x = points[i], y = points[n + i], z = points[2 * n + i];
        double u = tail[0] + x * tail[3] + y * tail[6] + z * tail[9];
        double v = tail[1] + x * tail[4] + y * tail[7] + z * tail[10];
        double w = tail[2] + x * tail[5] + y * tail[8] + z * tail[11];
#pragma omp simd reduction(+ : u, v, w)
        for (std::ptrdiff_t j = 0; j < s; ++j) {
            const double dx = x - sources[j], dy = y - sources[s + j], dz = z - sources[2 * s + j];
            const double phi = basis(dx * dx + dy * dy + dz * dz);
            u += phi * weights[j];
            v += phi * weights[s + j];
            w += phi * weights[2 * s + j];
        }
        result[i] = u, result[n + i] = v, result[2 * n + i] = w;
    }
}

}  // namespace

extern "C" void kernel_sum(int basis, double radius, std::ptrdiff_t n, std::ptrdiff_t s, const double* points,
                           const double* sources, const double* weights, const double* tail, double* result) {
    const double inverse = 1.0 / radius;
    switch (basis) {
        case 0: return sum(ThinPlateSpline{}, n, s, points, sources, weights, tail, result);
        case 1: return sum(WendlandC2{inverse}, n, s, points, sources, weights, tail, result);
        case 2: return sum(Gaussian{inverse}, n, s, points, sources, weights, tail, result);
        case 3: return sum(Multiquadric{inverse}, n, s, points, sources, weights, tail, result);
    }
}
