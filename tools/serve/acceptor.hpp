// SPDX-License-Identifier: Apache-2.0
// Listens and accepts connections for gRPC, because gRPC's own listener (1.51) ends for
// good when no descriptor is free.
#pragma once

#include <functional>
#include <string>
#include <thread>
#include <vector>

namespace relidar::serve {

class Acceptor {
public:
    /// Receives a connection and owns its descriptor from then on. Is called on the
    /// acceptor's thread.
    using Receive = std::function<void(int listener, int connection)>;

    /// Listens at all addresses of the host. @param address  HOST:PORT, port 0: a free
    /// one
    /// @throws UsageError if the text is no HOST:PORT, or this machine cannot listen
    /// there
    explicit Acceptor(const std::string& address);
    ~Acceptor();
    Acceptor(const Acceptor&) = delete;
    Acceptor& operator=(const Acceptor&) = delete;

    int port() const { return port_; }
    /// Accepts connections from now on. Closes new ones while so many are open that few
    /// descriptors are left.
    void start(Receive receive);
    /// Accepts no more. Returns when no connection is being received.
    void stop();

private:
    std::vector<int> listeners_;
    int wake_[2] = {-1, -1};  ///< a pipe that ends the thread's wait
    int port_ = 0;
    Receive receive_;
    std::thread thread_;

    void close_all();
    void serve();
    void accept_one(int listener);
};

}  // namespace relidar::serve
