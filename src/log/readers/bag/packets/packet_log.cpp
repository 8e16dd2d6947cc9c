// SPDX-License-Identifier: Apache-2.0
#include "log/readers/bag/packets/packet_log.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

#include "log/clouds/arrange_firings.hpp"
#include "log/readers/bag/packets/fired_points.hpp"
#include "log/sensor/beam_geometry.hpp"

namespace relidar::packets {
namespace {

// maximum number of firings per revolution; a revolution of two seconds has fewer
constexpr int kMostFirings = 40000;
constexpr std::int64_t kLongestTurn_ns = 2000000000;
constexpr std::size_t kMostInMessage = 0xFFFF;
constexpr double kBehind_deg = 180.0;
constexpr double kMostBright = 65535.0;
// A larger azimuth step between two firings shows a sector in which the sensor does not
// fire.
constexpr double kJump_deg = 5.0;
// The user gets a note about an incomplete first or last revolution if more than this
// share of it was recorded.
constexpr double kCutOff = 0.02;

// Returns true if the sensor fires at a column. Columns outside the image continue on the
// other side.
bool is_firing_at(const std::vector<bool>& fires, std::int64_t column) {
    const auto n = std::int64_t(fires.size());
    return fires[std::size_t((column % n + n) % n)];
}

}  // namespace

void PacketLog::add(const std::vector<PacketView>& packets, std::int64_t log_ns, const bag::Place& place,
                    const Calibration& calibration) {
    messages_.push_back({place, log_ns});
    Calibration of_first = calibration;
    of_first.has_two_returns = !product_ && have_dual_returns(packets);
    if (packets.size() > kMostInMessage)
        throw DataError(
            fmt::format("a message has {} packets, expected at most {}", packets.size(), kMostInMessage));
    for (std::size_t i = 0; i < packets.size(); ++i) {
        check_product(packets[i], of_first);
        add_packet(packets[i], std::uint16_t(i));
    }
}

void PacketLog::check_product(const PacketView& packet, const Calibration& calibration) {
    if (product_ && product_ == find_product(packet.bytes, calibration_)) return;
    const Product* product = find_product(packet.bytes, calibration);
    if (product_)
        throw DataError(
            fmt::format("found a packet of {} bytes of {}, expected a packet of a {} like the "
                        "previous ones",
                        packet.bytes.size(), product ? product->name : "no known product", product_->name));
    if (!product || !product->make) throw DataError(describe_unknown_packet(product, packet.bytes));
    decoder_ = product->make(product->name, calibration);
    product_ = product;
    calibration_ = calibration;
}

/// Returns the angle between two columns, for a sensor that fires at fixed azimuths.
double PacketLog::step_deg() const { return 360.0 / double(decoder_->timing().fires.size()); }

void PacketLog::add_packet(const PacketView& view, std::uint16_t in_message) {
    const Packet packet = decoder_->decode(view.bytes);
    if (packet.firings.empty()) {
        ++n_empty_;
        return;
    }
    n_slots_ = packet.n_slots;
    const auto message = std::uint32_t(messages_.size() - 1);
    const auto hash = std::uint32_t(std::hash<std::string_view>()(view.bytes));
    const std::size_t n = packet.firings.size();
    const bool is_at_end = packet.firings.back().after_us < -packet.firings.front().after_us;
    // azimuth step from firing f to the next firing
    const auto step_deg = [&](std::size_t f) {
        return compute_rotation_deg(packet.firings[f].azimuth_deg, packet.firings[f + 1].azimuth_deg);
    };
    const bool may_skip = decoder_->timing().fires.empty();
    double skipped_deg = 0.0;
    for (std::size_t f = 0; is_at_end && may_skip && f + 1 < n; ++f)
        skipped_deg -= step_deg(f) > kJump_deg ? step_deg(f) : 0.0;
    for (std::size_t first = 0, f = 0; f < n; ++f) {
        const bool is_last = f + 1 == n, jumps = !is_last && may_skip && step_deg(f) > kJump_deg;
        if (!is_last && !jumps) continue;
        const Firing& begin = packet.firings[first];
        const std::int64_t after_ns = std::llround(1e3 * begin.after_us);
        const int begin_slot = first == 0 && may_skip ? 0 : begin.slot,
                  end_slot = is_last ? n_slots_ : packet.firings[f + 1].slot;
        Entry entry{view.stamp_ns + after_ns,
                    packet.clock_ns + after_ns,
                    begin.azimuth_deg,
                    0.0f,
                    float(skipped_deg),
                    message,
                    in_message,
                    std::uint16_t(first),
                    std::uint16_t(f + 1 - first),
                    std::int16_t(begin.slot),
                    std::int16_t(end_slot - begin_slot),
                    hash,
                    std::exchange(n_empty_, std::uint16_t(0))};
        for (std::size_t k = first; k < f; ++k) entry.turned_deg += float(step_deg(k));
        unwrap_clock(entry);
        packets_.push_back(entry);
        if (jumps) skipped_deg += step_deg(f);
        first = f + 1;
    }
    if (decoder_->timing().is_wide) count_max_intensities(packet);
}

/// Unwraps the sensor's clock, which restarts at 0 after a fixed time. The time stamps of
/// the packets show how often it has restarted.
void PacketLog::unwrap_clock(Entry& entry) const {
    const double wrap_us = decoder_->timing().wrap_us;
    if (packets_.empty() || !(wrap_us > 0.0)) return;
    const Entry& before = packets_.back();
    const double passed_stamp_us = 1e-3 * double(entry.stamp_ns - before.stamp_ns),
                 passed_us = 1e-3 * double(entry.clock_ns - before.clock_ns);
    entry.clock_ns += std::llround(1e3 * wrap_us * std::round((passed_stamp_us - passed_us) / wrap_us));
}

void PacketLog::count_max_intensities(const Packet& packet) {
    n_bright_.resize(kMostBright + 1);
    for (const auto& returns : packet.echoes)
        for (const Echo& echo : returns)
            if (echo.range_m > 0.0f)
                ++n_bright_[std::size_t(
                    std::clamp(std::round(255.0 * double(echo.intensity)), 0.0, kMostBright))];
}

void PacketLog::finish() {
    if (packets_.empty()) return;
    faults_ = sort_packets(packets_);
    n_packets_ = std::size_t(std::ranges::count(packets_, 0, &Entry::first_firing));
    const Timing& timing = decoder_->timing();
    deg_us_ = unwrap_azimuths(packets_, timing);
    if (timing.fires.empty() && deg_us_ > 0.0)
        skipped_ = find_skipped_sector(packets_, deg_us_ * timing.cycle_us);
    find_revolutions();
}

/// Returns the number of packets that the sensor has sent since the previous packet; 1 if
/// no packet was lost. For a sensor that fires at fixed azimuths.
std::size_t PacketLog::count_steps_to(std::size_t packet) const {
    const Entry &entry = packets_[packet], &before = packets_[packet - 1];
    const double n =
        ((entry.azimuth_deg - before.azimuth_deg) / step_deg() - entry.first_slot + before.first_slot) /
        double(n_slots_);
    return std::size_t(std::clamp(std::round(n), 1.0, 1e9));
}

/// Returns the number of firings in lost packets before this packet, without the sector
/// that the sensor skips. For a sensor that fires at any azimuth.
double PacketLog::count_lost_slots(std::size_t packet) const {
    const Entry &entry = packets_[packet], &before = packets_[packet - 1];
    const double cycle_us = decoder_->timing().cycle_us,
                 slots = 1e-3 * double(entry.clock_ns - before.clock_ns) / cycle_us,
                 skipped_deg = skipped_.compute_overlap_deg(before.azimuth_deg, entry.azimuth_deg);
    return slots - (skipped_deg > 0.0 ? skipped_deg / (deg_us_ * cycle_us) : 0.0) - before.n_slots;
}

/// Returns the number of packets that were lost before this packet. Packets without a
/// firing are not counted, because the sensor may not send them.
std::size_t PacketLog::count_missing_before(std::size_t packet) const {
    const std::vector<bool>& fires = decoder_->timing().fires;
    if (fires.empty())
        return std::size_t(std::clamp(std::round(count_lost_slots(packet) / double(n_slots_)), 0.0, 1e9));
    const std::size_t n = count_steps_to(packet) - 1;
    if (n * std::size_t(n_slots_) > 2 * fires.size()) return n;
    // A received packet without a firing is not lost.
    const std::size_t n_lost = n - std::min<std::size_t>(n, packets_[packet].n_empty_before);
    const Entry& before = packets_[packet - 1];
    std::int64_t column = std::llround((before.azimuth_deg - kBehind_deg) / step_deg()) - before.first_slot;
    std::size_t missing = 0;  // number of lost packets with at least one firing
    for (std::size_t k = 0; k < n; ++k) {
        column += n_slots_;
        bool any = false;
        for (int slot = 0; slot < n_slots_; ++slot) any = any || is_firing_at(fires, column + slot);
        missing += any;
    }
    return std::min(missing, n_lost);
}

/// Counts the lost packets of a revolution. If packets were lost at its start or end,
/// counts only the share of them that belongs to this revolution.
void PacketLog::count_missing(PacketTurn& turn) const {
    double n_missing = 0.0;
    const double compute_slot_deg = deg_us_ * decoder_->timing().cycle_us;
    const std::size_t end = std::min(turn.last + 2, packets_.size());
    for (std::size_t i = turn.first + 1; i < end; ++i) {
        const Entry& before = packets_[i - 1];
        const double from_deg = before.azimuth_deg + double(before.turned_deg) + compute_slot_deg,
                     to_deg = packets_[i].azimuth_deg, width_deg = std::max(to_deg - from_deg, 1e-6);
        const double within_deg =
            std::min(to_deg, turn.begin_deg + 360.0) - std::max(from_deg, turn.begin_deg);
        n_missing += double(count_missing_before(i)) * std::clamp(within_deg / width_deg, 0.0, 1.0);
    }
    turn.n_missing = std::size_t(std::llround(n_missing));
    turn.has_gaps = n_missing > 0.0;
}

/// Returns the range of head angles that the packets cover. Adjacent angles at which the
/// sensor never fires are included.
std::pair<double, double> PacketLog::find_azimuth_reach_deg() const {
    const Entry &first = packets_.front(), &last = packets_.back();
    const std::vector<bool>& fires = decoder_->timing().fires;
    if (fires.empty()) {
        if (!(skipped_.width_deg > 0.0)) return {first.azimuth_deg, last.azimuth_deg};
        // Includes the skipped sector if the packets begin or end at its edge.
        const double slack_deg = deg_us_ * decoder_->timing().cycle_us;
        const double last_deg = last.azimuth_deg + double(last.turned_deg);
        const double before_deg =
                         skipped_.compute_overlap_deg(first.azimuth_deg - slack_deg, first.azimuth_deg),
                     behind_deg = skipped_.compute_overlap_deg(last_deg, last_deg + slack_deg);
        return {first.azimuth_deg - (before_deg > 0.0 ? skipped_.width_deg : 0.0),
                behind_deg > 0.0 ? last_deg + skipped_.width_deg : last.azimuth_deg};
    }
    std::int64_t begin = std::llround((first.azimuth_deg - kBehind_deg) / step_deg());
    std::int64_t end =
        std::llround((last.azimuth_deg + double(last.turned_deg) - kBehind_deg) / step_deg()) + 1;
    for (std::size_t k = 0; k < fires.size() && !is_firing_at(fires, begin - 1); ++k) --begin;
    for (std::size_t k = 0; k < fires.size() && !is_firing_at(fires, end); ++k) ++end;
    return {kBehind_deg + step_deg() * double(begin), kBehind_deg + step_deg() * double(end)};
}

void PacketLog::find_revolutions() {
    const auto [first_deg, end] = find_azimuth_reach_deg();
    double begin = kBehind_deg + 360.0 * std::ceil((first_deg - kBehind_deg) / 360.0);
    if (begin - first_deg > 360.0 * kCutOff) ++left_out_.n_cut_off;
    for (std::size_t p = 0; p < packets_.size() && begin + 360.0 <= end; begin += 360.0) {
        PacketTurn turn{0, 0, 0, 0, begin, 0};
        // returns the first packet that begins after an azimuth
        const auto first_behind = [&](double azimuth) {
            return std::size_t(std::ranges::upper_bound(packets_, azimuth, {}, &Entry::azimuth_deg) -
                               packets_.begin());
        };
        turn.first = std::max(first_behind(begin), std::size_t(1)) - 1;
        turn.last = std::min(first_behind(begin + 360.0), packets_.size()) - 1;
        p = turn.last;
        // With two firing sequences, the next packet can contain the second sequence of
        // the last column.
        if (decoder_->timing().parts > 1) turn.last = std::min(turn.last + 1, packets_.size() - 1);
        // All packets of this revolution were lost, so the search continues at the next
        // packet.
        if (turn.first == turn.last) {
            const double next = packets_[std::min(p + 1, packets_.size() - 1)].azimuth_deg, lost = begin;
            begin = std::max(begin, kBehind_deg + 360.0 * (std::floor((next - kBehind_deg) / 360.0) - 1.0));
            left_out_.n_lost += std::size_t(std::llround((begin - lost) / 360.0)) + 1;
            continue;
        }
        count_missing(turn);
        compute_turn_times(turn);
        if (2 * turn.n_missing >= turn.last - turn.first) ++left_out_.n_lost;
        else if (!is_evenly_sampled(turn)) ++left_out_.n_jumps;
        else turns_.push_back(turn);
    }
    if (end - begin > 360.0 * kCutOff) ++left_out_.n_cut_off;
}

std::string PacketLog::problems() const {
    std::vector<std::string> texts;
    const auto add = [&](std::size_t count, const char* text) {
        if (count > 0) texts.push_back(fmt::format("{} {}", count, text));
    };
    add(faults_.n_repeated, "packets were received twice");
    add(faults_.n_late, "packets were received late and are sorted by the clock of the sensor");
    const double all_deg =
        packets_.back().azimuth_deg + double(packets_.back().turned_deg) - packets_.front().azimuth_deg;
    if (turns_.empty() && all_deg < 360.0)
        texts.push_back(
            fmt::format("the packets cover only {:.0f} degrees of a turn, expected at least "
                        "one full turn",
                        std::max(all_deg, 0.0)));
    else add(left_out_.n_cut_off, "turns are skipped, because the recording begins or ends during them");
    add(left_out_.n_lost, "turns are skipped, because at least a third of their packets is missing");
    add(left_out_.n_jumps,
        "turns are skipped, because the clock of the sensor jumps during them, or because packets of two "
        "sensors are mixed");
    if (skipped_.width_deg > 0.0)
        texts.push_back(
            fmt::format("the sensor fires in {:.0f} degrees of a turn, so the other {:.0f} degrees have no "
                        "rays",
                        360.0 - skipped_.width_deg, skipped_.width_deg));
    return fmt::format("{}", fmt::join(texts, "; "));
}

/// Computes when the head faces forward in a revolution. If the sensor's clock defines
/// the times, also computes the difference between time stamps and this clock.
void PacketLog::compute_turn_times(PacketTurn& turn) const {
    const double forward = turn.begin_deg + 180.0;
    const auto behind =
        std::ranges::upper_bound(packets_, forward, {}, &Entry::azimuth_deg) - packets_.begin();
    const std::size_t k = std::clamp(std::size_t(behind), std::size_t(1), packets_.size() - 1);
    const Entry &before = packets_[k - 1], &after = packets_[k];
    const double s = (forward - before.azimuth_deg) / std::max(after.azimuth_deg - before.azimuth_deg, 1e-6);
    turn.forward_ns = before.stamp_ns + std::int64_t(s * double(after.clock_ns - before.clock_ns));
    turn.log_ns = messages_[before.message].log_ns;
    if (decoder_->timing().fires.empty()) return;
    turn.stamp_less_clock_ns = before.stamp_ns - before.clock_ns;
    for (std::size_t i = turn.first; i <= turn.last; ++i)
        turn.stamp_less_clock_ns =
            std::min(turn.stamp_less_clock_ns, packets_[i].stamp_ns - packets_[i].clock_ns);
    turn.forward_ns += before.clock_ns + turn.stamp_less_clock_ns - before.stamp_ns;
}

/// Returns true if the sensor's clock advances from packet to packet during a revolution,
/// and if the revolution is not too long.
bool PacketLog::is_evenly_sampled(const PacketTurn& turn) const {
    const double slot_ns = 1e3 * decoder_->timing().cycle_us;
    for (std::size_t i = turn.first + 1; i <= turn.last; ++i) {
        const Entry &entry = packets_[i], &before = packets_[i - 1];
        if (double(entry.clock_ns - before.clock_ns) < 0.5 * slot_ns * before.n_slots) return false;
    }
    return packets_[turn.last].clock_ns - packets_[turn.first].clock_ns <= kLongestTurn_ns;
}

/// Returns the first message with packets of a revolution. Tests all packets, because
/// packets are sorted by time and may have another order than the messages.
std::uint32_t PacketLog::find_first_message(const PacketTurn& turn) const {
    std::uint32_t first = packets_[turn.first].message;
    for (std::size_t i = turn.first; i <= turn.last; ++i) first = std::min(first, packets_[i].message);
    return first;
}

std::vector<PacketLog::Source> PacketLog::messages(const PacketTurn& turn) const {
    std::uint32_t last = 0;
    for (std::size_t i = turn.first; i <= turn.last; ++i) last = std::max(last, packets_[i].message);
    return {messages_.begin() + find_first_message(turn), messages_.begin() + last + 1};
}

/// Returns the mean azimuth step from firing to firing in a revolution.
double PacketLog::compute_slot_deg(const PacketTurn& turn) const {
    std::size_t n = 0;
    for (std::size_t i = turn.first; i < turn.last; ++i)
        n += std::size_t(packets_[i].n_slots) + count_missing_before(i + 1) * std::size_t(n_slots_);
    const double first_deg = packets_[turn.first].azimuth_deg, last_deg = packets_[turn.last].azimuth_deg;
    return std::max(last_deg - first_deg - skipped_.compute_overlap_deg(first_deg, last_deg), 1.0) /
           double(std::max<std::size_t>(n, 1));
}

SpinningSensor PacketLog::sensor() const {
    const double period_s = std::clamp(360e-6 / std::max(deg_us_, 1e-9), 0.02, 1.0);
    const Timing& timing = decoder_->timing();
    if (!timing.fires.empty()) return decoder_->sensor(int(timing.fires.size()), 1.0 / period_s);
    // The scan needs a column for each firing of the revolution with the most firings.
    double most = 1e6 * period_s / timing.cycle_us;
    for (const PacketTurn& turn : turns_) most = std::max(most, 360.0 / compute_slot_deg(turn));
    most /= double(timing.parts);
    return decoder_->sensor(std::min(int(std::ceil(most)) + 1, kMostFirings), 1.0 / period_s);
}

/// Returns the maximum intensity of all returns, in units in which 255 means intensity 1.
double PacketLog::find_max_intensity() const {
    std::size_t most = n_bright_.size();
    while (most > 0 && n_bright_[most - 1] == 0) --most;
    return most > 0 ? double(most - 1) : 0.0;
}

/// Returns the value that becomes the intensity 1: the 99.5th percentile, if some
/// intensities exceed 1.
double PacketLog::intensity_max() const {
    if (find_max_intensity() <= 255.0) return 1.0;
    std::uint64_t n = 0, left = 0;
    for (const std::uint32_t count : n_bright_) n += count;
    left = std::uint64_t(0.995 * double(n - 1));
    std::size_t at = 0;
    while (n_bright_[at] <= left) left -= n_bright_[at++];
    return std::max(double(at), 1.0) / 255.0;
}

std::string PacketLog::about() const {
    if (find_max_intensity() <= 255.0) return decoder_->about();
    return fmt::format("{}, reflectivities up to {:.4g} are divided by {:.4g}, their 99.5th percentile",
                       decoder_->about(), find_max_intensity(), 255.0 * intensity_max());
}

/// Decodes a packet again to build the scan. Packets are first decoded when the index is
/// built.
/// @param message  index in `packets` of the message that contains the packet
Packet PacketLog::reread_packet(std::size_t message, const Entry& entry,
                                const std::vector<std::vector<PacketView>>& packets) const {
    const std::size_t m = message;
    if (m >= packets.size() || entry.in_message >= packets[m].size())
        throw DataError("the recording has changed: a message has fewer packets than before");
    const PacketView& view = packets[m][entry.in_message];
    if (find_product(view.bytes, calibration_) != product_)
        throw DataError("the recording has changed: a packet differs from the one that was read before");
    return decoder_->decode(view.bytes);
}

/// Converts an azimuth to a column of a revolution. Azimuths outside the revolution give
/// an invalid column.
int PacketLog::compute_column(const PacketTurn& turn, double azimuth_deg) const {
    const double n = double(decoder_->timing().fires.size());
    return int(std::clamp(std::round((azimuth_deg - turn.begin_deg) / step_deg()), -n, 2.0 * n));
}

/// Returns for each column of a revolution whether its packet was lost. Empty for a
/// sensor that fires at any azimuth.
std::vector<bool> PacketLog::find_lost_columns(const PacketTurn& turn) const {
    const std::vector<bool>& fires = decoder_->timing().fires;
    std::vector<bool> is_lost(fires.size(), false);
    const std::size_t end_packet = std::min(turn.last + 2, packets_.size());
    for (std::size_t i = turn.first + 1; i < end_packet && !fires.empty(); ++i) {
        if (count_missing_before(i) == 0) continue;
        const Entry &entry = packets_[i], &before = packets_[i - 1];
        const int begin = compute_column(turn, before.azimuth_deg) - before.first_slot + n_slots_;
        const int end =
            std::min(compute_column(turn, entry.azimuth_deg) - entry.first_slot, int(fires.size()));
        for (int c = std::max(begin, 0); c < end; ++c) is_lost[std::size_t(c)] = fires[std::size_t(c)];
    }
    return is_lost;
}

Scan PacketLog::scan(const PacketTurn& turn, const std::vector<std::vector<PacketView>>& packets,
                     const SpinningSensor& sensor, std::int64_t zero_ns) const {
    FiredPoints fired;
    const std::vector<BeamGeometry> beams = make_beam_geometries(sensor.beams);
    const Timing& timing = decoder_->timing();
    const double mean_deg_us = 360e-6 / sensor.period_s, brightness = intensity_max();
    const int n_columns = int(timing.fires.size());
    const std::uint32_t first_of_turn = find_first_message(turn);
    // number of firings of the revolution before this packet, including those in lost
    // packets
    std::size_t before = 0;
    int previous_number = -1;
    bool is_inside = false;
    for (std::size_t p = turn.first; p <= turn.last; ++p) {
        const Entry& entry = packets_[p];
        if (p > turn.first && n_columns == 0)
            before += std::size_t(packets_[p - 1].n_slots) + count_missing_before(p) * std::size_t(n_slots_);
        Packet packet = reread_packet(entry.message - first_of_turn, entry, packets);
        const std::size_t begin = entry.first_firing, end = begin + entry.n_firings;
        if (packet.firings.size() < end) continue;
        const std::int64_t begin_ns =
            timing.fires.empty() ? entry.stamp_ns : entry.clock_ns + turn.stamp_less_clock_ns;
        const double begin_s = 1e-9 * double(begin_ns - zero_ns), first_us = packet.firings[begin].after_us;
        double azimuth = entry.azimuth_deg, step = 0.0;
        for (std::size_t f = begin; f < end; ++f) {
            const Firing& firing = packet.firings[f];
            azimuth += f > begin ? step : 0.0;
            if (f + 1 < end)
                step = compute_rotation_deg(firing.azimuth_deg, packet.firings[f + 1].azimuth_deg);
            // With several firing sequences per column: time from the first one to this
            // one.
            const double late_us = timing.cycle_us * double(firing.part);
            const double start_deg = azimuth - late_us * mean_deg_us;
            const int slot = int(before) + firing.slot - entry.first_slot;
            const int number = n_columns > 0 ? compute_column(turn, azimuth)
                                             : (slot - firing.part + timing.parts) / timing.parts;
            // Firings of the same column (equal numbers) belong to the same revolution.
            if (number != previous_number)
                is_inside = n_columns > 0 ? number >= 0 && number < n_columns
                                          : start_deg >= turn.begin_deg && start_deg < turn.begin_deg + 360.0;
            previous_number = number;
            if (!is_inside) continue;
            const double time_s = begin_s + 1e-6 * (firing.after_us - first_us - late_us);
            const double ahead_deg_us = timing.interpolates ? step / timing.cycle_us - mean_deg_us : 0.0;
            std::array<Echo, 2>* echoes = &packet.echoes[f * sensor.beams.size()];
            add_firing(fired, {start_deg, time_s, number, ahead_deg_us, brightness}, echoes, beams,
                       timing.offset_us);
        }
    }
    return arrange_points(turn, fired, sensor);
}

/// Creates the scan of a revolution from its points.
Scan PacketLog::arrange_points(const PacketTurn& turn, FiredPoints& fired,
                               const SpinningSensor& sensor) const {
    if (fired.points.size() == 0) return make_unordered_scan(fired.points);
    if (!decoder_->timing().fires.empty())
        return make_fired_scan(fired, decoder_->timing().fires, find_lost_columns(turn), sensor);
    const Sweep sweep = sort_firings(fired.points, fired.numbers, fired.head_rad);
    // Complete revolutions all have the same number of columns. After packet loss, the
    // scan has only the columns that were received.
    SpinningSensor seen = sensor;
    seen.columns = int(std::ceil(double(sensor.columns) * (1.0 - skipped_.width_deg / 360.0)));
    if (turn.has_gaps) seen.columns = int(sweep.firings.size());
    return make_spinning_scan(fired.points, seen, sweep);
}

}  // namespace relidar::packets
