// SPDX-License-Identifier: Apache-2.0
// Random numbers with a seed, which are equal on every machine. SplitMix64 (Steele, Lea,
// Flood 2014) is the generator and the hash function. Normally distributed numbers use
// the method of Box and Muller.
#pragma once

#include <cmath>
#include <cstdint>

namespace relidar {

inline std::uint64_t hash_integer(std::uint64_t value) {
    value += 0x9E3779B97F4A7C15ull;
    value = (value ^ (value >> 30)) * 0xBF58476D1CE4E5B9ull;
    value = (value ^ (value >> 27)) * 0x94D049BB133111EBull;
    return value ^ (value >> 31);
}

/// Exchanging the numbers changes the hash.
inline std::uint64_t hash_pair(std::uint64_t first, std::uint64_t second) {
    return hash_integer(hash_integer(first) ^ (second * 0xD6E8FEB86659FD93ull));
}

class Random {
public:
    explicit Random(std::uint64_t seed) : state_(hash_integer(seed)) {}

    std::uint64_t next_uint64() { return hash_integer(state_ += 0x9E3779B97F4A7C15ull); }

    std::uint64_t& state() { return state_; }

    double sample_uniform() { return static_cast<double>(next_uint64() >> 11) * 0x1.0p-53; }

    double sample_uniform(double min_value, double max_value) {
        return min_value + (max_value - min_value) * sample_uniform();
    }

    double sample_normal() {
        const double radius = std::sqrt(-2.0 * std::log(1.0 - sample_uniform()));
        return radius * std::cos(6.283185307179586 * sample_uniform());
    }

private:
    std::uint64_t state_;
};

}  // namespace relidar
