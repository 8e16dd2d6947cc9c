// SPDX-License-Identifier: Apache-2.0
#include "read/packets/packet_log.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "base/geometry/circular_gap.hpp"

namespace relidar::packets {
namespace {

constexpr double kMaxEncoderNoise_deg = 1.0;  // A smaller decrease of the encoder angle is accepted as noise.
// Maximum network delay. If the sensor's clock decreases by more, it was set back.
constexpr std::int64_t kMaxDelay_ns = 100000000;
// If two packets are farther apart in time than this, the recording was paused.
constexpr std::int64_t kMinPause_ns = 200000000;
// Number of azimuth bins (0.5 degrees each) in which the skipped sector is searched.
constexpr std::size_t kSectorBins = 720;
// A narrower gap between firings does not count as a skipped sector.
constexpr double kLeastSector_deg = 10.0;

/// Returns the mean rotation rate of the head in degrees per microsecond; 0 if unknown.
/// Ignores packets next to a skipped sector, pauses, and clocks that were set back.
/// @param packets  with continuous azimuths
double rotation_deg_per_us(const std::vector<PacketIndexEntry>& packets) {
    double turned_deg = 0.0, passed_us = 0.0;
    for (std::size_t p = 1; p < packets.size(); ++p) {
        const PacketIndexEntry &before = packets[p - 1], &entry = packets[p];
        const std::int64_t passed_ns = entry.clock_ns - before.clock_ns;
        const bool is_next_to_sector = entry.skipped_deg != 0.0f || before.skipped_deg != 0.0f;
        if (is_next_to_sector || passed_ns <= 0 || passed_ns > kMinPause_ns) continue;
        turned_deg += entry.azimuth_deg - before.azimuth_deg;
        passed_us += 1e-3 * double(passed_ns);
    }
    return passed_us > 0.0 ? turned_deg / passed_us : 0.0;
}

/// Returns true if one of the packets before index `end` is the same part of the same
/// packet: it has the same time, bytes (hash) and first slot.
bool is_repeated(const std::vector<PacketIndexEntry>& packets, std::size_t end,
                 const PacketIndexEntry& entry) {
    // If the sensor's clock stands still, many packets have the same time.
    constexpr std::size_t kMostCompared = 64;
    const std::size_t begin = end - std::min(end, kMostCompared);
    for (std::size_t k = end; k > begin && packets[k - 1].clock_ns == entry.clock_ns; --k)
        if (packets[k - 1].hash == entry.hash && packets[k - 1].first_slot == entry.first_slot) return true;
    return false;
}

/// Returns where a packet belongs in the sorted packets [0, n): before the packets with a
/// later sensor clock. If its clock is earlier by more than a network delay, the clock
/// was set back, so the packet stays last.
std::size_t find_sorted_index(const std::vector<PacketIndexEntry>& packets, std::size_t n,
                              const PacketIndexEntry& entry) {
    const auto is_later = [&](std::size_t index) { return packets[index].clock_ns > entry.clock_ns; };
    std::size_t at = n;
    while (at > 0 && is_later(at - 1) && packets[at - 1].clock_ns - entry.clock_ns <= kMaxDelay_ns) --at;
    const bool was_set_back = at > 0 && is_later(at - 1);
    return was_set_back ? n : at;
}

/// Corrects the receive time of a late packet, which belongs at index `at` of the sorted
/// packets [0, n). The new time is its clock plus stamp_ns - clock_ns of the packet
/// before it. Raises later stamps by the same rule, so that they do not precede the new
/// time. Without a packet before it, uses the one after it, whose stamp is later anyway.
void correct_late_stamp(std::vector<PacketIndexEntry>& packets, std::size_t n, std::size_t at,
                        PacketIndexEntry& late) {
    const PacketIndexEntry& neighbour = packets[at > 0 ? at - 1 : at];
    const std::int64_t stamp_less_clock_ns = neighbour.stamp_ns - neighbour.clock_ns;
    late.stamp_ns = late.clock_ns + stamp_less_clock_ns;
    for (std::size_t k = at; at > 0 && k < n; ++k)
        packets[k].stamp_ns = std::max(packets[k].stamp_ns, packets[k].clock_ns + stamp_less_clock_ns);
}

/// Returns for each azimuth bin whether the sensor has fired in it.
/// @param packets  with the first azimuth and the rotation up to the last firing of each
std::array<bool, kSectorBins> mark_fired_bins(const std::vector<PacketIndexEntry>& packets,
                                              double firing_step_deg) {
    constexpr double kTestStep_deg = 0.4;  // narrower than a bin, so that no bin is missed
    std::array<bool, kSectorBins> has_firings{};
    for (const PacketIndexEntry& entry : packets) {
        const double covered_deg = std::min(double(entry.turned_deg), 360.0) + firing_step_deg;
        for (double offset_deg = 0.0; offset_deg <= covered_deg; offset_deg += kTestStep_deg) {
            const double azimuth_deg = std::max(entry.azimuth_deg + offset_deg, 0.0);
            has_firings[std::size_t(azimuth_deg / 360.0 * kSectorBins) % kSectorBins] = true;
        }
    }
    return has_firings;
}

}  // namespace

double rotation_deg(double from_azimuth_deg, double to_azimuth_deg) {
    const double step = std::remainder(to_azimuth_deg - from_azimuth_deg, 360.0);
    return step < -kMaxEncoderNoise_deg ? step + 360.0 : step;
}

PacketFaultCounts sort_packets(std::vector<PacketIndexEntry>& packets) {
    // An insertion sort: packets[0, n) are already sorted. Most packets stay last.
    PacketFaultCounts faults;
    std::size_t n = 0;
    for (std::size_t p = 0; p < packets.size(); ++p) {
        PacketIndexEntry entry = packets[p];
        const std::size_t at = find_sorted_index(packets, n, entry);
        // A packet can have two entries. Counts only that with its first firing.
        const bool is_first_entry = entry.first_firing == 0;
        if (is_repeated(packets, at, entry)) {
            if (is_first_entry) ++faults.n_repeated;
            continue;
        }
        const bool is_late = at < n;
        if (is_late) correct_late_stamp(packets, n, at, entry);
        if (is_late && is_first_entry) ++faults.n_late;
        const auto place = packets.begin() + std::ptrdiff_t(at), end = packets.begin() + std::ptrdiff_t(n);
        std::move_backward(place, end, end + 1);
        packets[at] = entry;
        ++n;
    }
    packets.resize(n);
    return faults;
}

double unwrap_azimuths(std::vector<PacketIndexEntry>& packets, const FiringTiming& timing) {
    // rotation rate in degrees per microsecond: fixed, or that of the current packet
    double deg_us = timing.has_fixed_columns() ? 360.0 / double(timing.fires.size()) / timing.cycle_us : 0.0;
    // Time in which the head passes the sectors of PacketIndexEntry::skipped_deg.
    const auto skipped_us = [&](const PacketIndexEntry& entry) {
        return deg_us > 0.0 ? double(entry.skipped_deg) / deg_us : 0.0;
    };
    for (std::size_t p = 0; p < packets.size(); ++p) {
        if (!timing.has_fixed_columns() && packets[p].n_slots > 3)
            deg_us = double(packets[p].turned_deg) / (timing.cycle_us * double(packets[p].n_slots - 1));
        if (p == 0) continue;
        PacketIndexEntry& entry = packets[p];
        const PacketIndexEntry& previous = packets[p - 1];
        const double passed_us =
            1e-3 * double(entry.clock_ns - previous.clock_ns) + skipped_us(entry) - skipped_us(previous);
        // Makes the azimuth continue the azimuth of the previous packet. The number of
        // full revolutions between them is computed from elapsed time and rotation rate.
        const double azimuth_deg =
            previous.azimuth_deg + rotation_deg(std::fmod(previous.azimuth_deg, 360.0), entry.azimuth_deg);
        const double expected_deg = previous.azimuth_deg + deg_us * passed_us;
        entry.azimuth_deg =
            azimuth_deg + 360.0 * std::max(0.0, std::round((expected_deg - azimuth_deg) / 360.0));
    }
    // From here, uses the mean rate, which is more exact than that in the last packet.
    const double mean_deg_us = rotation_deg_per_us(packets);
    if (mean_deg_us > 0.0) deg_us = mean_deg_us;
    for (std::size_t p = 0; p < packets.size() && deg_us > 0.0; ++p) {
        PacketIndexEntry& entry = packets[p];
        if (entry.skipped_deg == 0.0f) continue;
        // The head passed a sector without firings during this packet. Computes the time
        // from a neighbour on the same side of the sector: the next entry if the sector
        // precedes `entry`, otherwise the previous. Without a neighbour (p - 1 of the
        // first entry is out of range too), computes it from the width of the sector.
        const std::size_t beside = entry.skipped_deg > 0.0f ? p + 1 : p - 1;
        std::int64_t skipped_ns = std::llround(1e3 * skipped_us(entry));
        if (beside < packets.size())
            skipped_ns = packets[beside].clock_ns - entry.clock_ns +
                         std::llround(1e3 * (entry.azimuth_deg - packets[beside].azimuth_deg) / deg_us);
        entry.clock_ns += skipped_ns;
        entry.stamp_ns += skipped_ns;
    }
    return deg_us;
}

double SkippedSector::overlap_deg(double from_deg, double to_deg) const {
    // Returns how many degrees of the sector the head passes from the start of the sector
    // to an azimuth. Each full turn adds `width_deg`.
    const auto until = [&](double azimuth_deg) {
        const double turns = std::floor((azimuth_deg - begin_deg) / 360.0);
        return turns * width_deg + std::min(azimuth_deg - begin_deg - 360.0 * turns, width_deg);
    };
    return width_deg > 0.0 ? until(to_deg) - until(from_deg) : 0.0;
}

SkippedSector find_skipped_sector(const std::vector<PacketIndexEntry>& packets, double firing_step_deg) {
    constexpr double kBin_deg = 360.0 / kSectorBins;
    const std::array<bool, kSectorBins> has_firings = mark_fired_bins(packets, firing_step_deg);
    const CircularGap gap = find_widest_gap(kSectorBins, [&](std::size_t bin) { return has_firings[bin]; });
    if (double(gap.length) * kBin_deg < kLeastSector_deg || gap.length >= kSectorBins) return {};

    // Bins are coarse, so measures the exact ends from the middle of the sector.
    const double middle_deg = (double(gap.end) - 0.5 * double(gap.length)) * kBin_deg;
    double before_deg = 360.0;  // from the last firing before the middle to the middle
    double behind_deg = 360.0;  // from the middle to the first firing behind it
    std::size_t n_skips = 0;    // number of times that the head passes the middle
    // Number of full turns of the head since the middle.
    const auto turn_of = [&](const PacketIndexEntry& entry) {
        return std::floor((entry.azimuth_deg - middle_deg) / 360.0);
    };
    const auto wrap = [](double angle_deg) { return angle_deg - 360.0 * std::floor(angle_deg / 360.0); };
    for (std::size_t p = 0; p < packets.size(); ++p) {
        const PacketIndexEntry& entry = packets[p];
        const double first_deg = entry.azimuth_deg, last_deg = first_deg + double(entry.turned_deg);
        before_deg = std::min(before_deg, wrap(middle_deg - last_deg));
        behind_deg = std::min(behind_deg, wrap(first_deg - middle_deg));
        if (p > 0 && turn_of(entry) > turn_of(packets[p - 1])) ++n_skips;
    }
    // The sector begins one step after the last firing before it.
    const double begin_deg = middle_deg - before_deg + firing_step_deg;
    const double width_deg = before_deg + behind_deg - firing_step_deg;
    if (n_skips < 2 || width_deg < kLeastSector_deg) return {};
    return {.begin_deg = begin_deg, .width_deg = width_deg};
}

}  // namespace relidar::packets
