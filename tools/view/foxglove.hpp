// SPDX-License-Identifier: Apache-2.0
// Plays the log for clients that speak Foxglove's WebSocket protocol, such as Foxglove
// and Lichtblick. Clients receive the topics and messages of the recording `mcap`:
//   text    serverInfo, advertise (topics with their Protobuf schemas), status (errors)
//   binary  1, subscription (uint32), time (uint64 ns), Protobuf message; or 2, time
// Clients send the texts subscribe and unsubscribe. Numbers are little-endian.
#pragma once

#include <deque>
#include <map>
#include <mutex>
#include <optional>

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "server.hpp"

namespace relidar::view {

struct FoxgloveSendCallbacks {
    std::function<void(ClientId, std::string)> text;
    std::function<void(ClientId, std::vector<std::string>)> scan;
};

/// Renders the sweeps of the log's first LiDAR in a loop. Only the thread that calls
/// send_due() uses the device.
class FoxglovePlayer {
public:
    FoxglovePlayer(const Run& run, Device& device, FoxgloveSendCallbacks answers);

    void add_client(ClientId client_id);
    bool handle_message(ClientId client_id, const std::string& message);
    void remove_client(ClientId client_id);

    /// Scans follow each other in the intervals of the log, or more slowly if the device
    /// is slow.
    /// @return the time until the next scan, but at most `max_wait`
    /// @throws DeviceError if the device has failed
    std::chrono::milliseconds send_due(std::chrono::milliseconds max_wait);

private:
    using Clock = std::chrono::steady_clock;
    struct Client {
        std::map<std::uint32_t, std::size_t> subscriptions = {};  ///< topic of each subscription
        std::deque<std::string> texts = {};                       ///< texts that will be sent
    };
    struct Playback {
        ScanRenderer renderer;
        ScanMessageEncoder messages;
        std::size_t frame = 0;  ///< index of the next scan in `times_s_`
        Clock::time_point due = Clock::now();

        Playback(Device& device, const Run& run, const ScanOutputOptions& format)
            : renderer(device, run), messages({format}) {}
    };

    void handle_operation(Client& client, const std::string& text) const;
    void add_subscription(Client& client, std::uint32_t id, std::uint32_t topic) const;
    bool flush_texts();
    void send_next();
    void publish(const std::vector<ScanMessage>& messages_per_topic);

    const Run& run_;
    Device& device_;
    const FoxgloveSendCallbacks answers_;
    const SimulatedSensor sensor_;
    const ScanOutputOptions format_;
    const std::vector<ScanTopic> topics_;
    std::vector<double> times_s_;  ///< times of the sweeps in the log
    std::optional<Playback> playback_;
    std::mutex mutex_;  ///< Protects `clients_`.
    std::map<ClientId, Client> clients_;
};

}  // namespace relidar::view
