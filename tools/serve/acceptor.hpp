// SPDX-License-Identifier: Apache-2.0
// Listens and accepts connections for gRPC, because the listener of gRPC 1.51 stops
// permanently when no file descriptor is free.
#pragma once

#include <functional>
#include <string>
#include <thread>
#include <vector>

namespace relidar::serve {

class Acceptor {
public:
    /// Receives a connection and takes ownership of its descriptor. Called on the
    /// acceptor's thread.
    using Receive = std::function<void(int listener, int connection)>;

    /// Listens at all addresses of the host.
    /// @param address HOST:PORT; port 0 selects a free port
    /// @throws UsageError if the text is not HOST:PORT, or the address is not available
    explicit Acceptor(const std::string& address);
    ~Acceptor();
    Acceptor(const Acceptor&) = delete;
    Acceptor& operator=(const Acceptor&) = delete;

    int port() const { return port_; }
    /// Starts to accept connections. Closes new connections while few free descriptors
    /// are left.
    void start(Receive receive);
    /// Stops accepting. Returns when no call of the callback is in progress.
    void stop();

private:
    std::vector<int> listeners_;
    int wake_[2] = {-1, -1};  ///< Pipe that wakes the waiting thread.
    int port_ = 0;
    Receive receive_;
    std::thread thread_;

    void close_all();
    void serve();
    void accept_one(int listener);
};

}  // namespace relidar::serve
