// SPDX-License-Identifier: Apache-2.0
// Plays the log for clients that speak Foxglove's WebSocket protocol, such as Foxglove
// and Lichtblick. Clients receive the topics and messages of the recording `mcap`:
//   text    serverInfo, advertise (topics with their Protobuf schemas), status (errors)
//   binary  1, subscription (uint32), time (uint64 ns), Protobuf message; or 2, time
// Clients send the texts subscribe and unsubscribe. Numbers are little-endian.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "server.hpp"

namespace relidar::view {

/// Callbacks that send messages to clients. Only play() calls them.
struct FoxgloveAnswers {
    std::function<void(ClientId, std::string)> text;
    /// Sends the binary messages of one scan.
    std::function<void(ClientId, std::vector<std::string>)> scan;
};

/// Renders the recorded sweeps of the log's first LiDAR in a loop while a client
/// subscribes to a topic. Only the thread that calls play() uses the device. The server's
/// thread calls the other functions.
class FoxglovePlayer {
public:
    /// Creates a player that renders nothing yet.
    /// @param run must outlive the player
    FoxglovePlayer(const Run& run, Device& device, FoxgloveAnswers answers);

    /// Describes the topics to a new client.
    void open(ClientId client);
    /// Handles a message of a client.
    /// @return false if the client was not opened here
    bool receive(ClientId client, const std::string& message);
    void close(ClientId client);

    /// Renders and sends the next scan if its time has come. Scans follow each other in
    /// the intervals of the log, or more slowly if the device is slow.
    /// @return the time until the next scan, but at most `patience`
    /// @throws DeviceError if the device has failed
    std::chrono::milliseconds play(std::chrono::milliseconds patience);

private:
    using Clock = std::chrono::steady_clock;
    struct Client {
        std::map<std::uint32_t, std::size_t> subscriptions = {};  ///< topic of each subscription
        std::deque<std::string> texts = {};                       ///< texts that will be sent
    };
    /// State that exists only while a client subscribes to a topic.
    struct Playback {
        ScanRenderer renderer;
        ScanMessages messages;
        std::size_t frame = 0;  ///< index of the next scan in `times_s_`
        Clock::time_point due = Clock::now();

        Playback(Device& device, const Run& run, const ScanFormat& format)
            : renderer(device, run), messages({format}) {}
    };

    void change_subscriptions(Client& client, const std::string& text) const;
    bool send_texts();
    void play_next_scan();
    void send(const std::vector<ScanMessage>& messages);
    void stop(const std::string& why);

    const Run& run_;
    Device& device_;
    const FoxgloveAnswers answers_;
    const SensorChoice sensor_;
    const ScanFormat format_;
    const std::vector<ScanTopic> topics_;
    std::vector<double> times_s_;  ///< times of the sweeps in the log
    std::optional<Playback> playback_;
    std::mutex mutex_;  ///< Protects `clients_`.
    std::map<ClientId, Client> clients_;
};

}  // namespace relidar::view
