// Says on one topic what it hears on another: a program of another vendor, as Fast DDS makes it.
// echo DOMAIN TYPE HEARD SAID [latched]; TYPE as in `sensor_msgs::msg::dds_::JointState_`.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>

#include "MessagesPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using namespace eprosima::fastrtps::rtps;

template <class Message>
struct Echo : DataReaderListener {
    DataWriter* writer = nullptr;
    void on_data_available(DataReader* reader) override {
        Message message;
        SampleInfo info;
        while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
            if (info.valid_data) writer->write(&message);
        }
    }
};

template <class Message, class Support>
bool serve(const char* name, DomainParticipant* participant, char** given, bool latched) {
    if (std::string(name) != given[2]) return false;
    TypeSupport type(new Support());
    type->setName(name);
    type.register_type(participant);
    auto in = participant->create_topic(given[3], given[2], TOPIC_QOS_DEFAULT);
    auto out = participant->create_topic(given[4], given[2], TOPIC_QOS_DEFAULT);

    DataWriterQos writing = DATAWRITER_QOS_DEFAULT;
    writing.reliability().kind = RELIABLE_RELIABILITY_QOS;
    writing.history().depth = 10;
    writing.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;  // A cloud has more than a datagram holds.
    writing.endpoint().history_memory_policy = PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    auto echo = new Echo<Message>();
    echo->writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(out, writing);
    DataReaderQos reading = DATAREADER_QOS_DEFAULT;
    reading.reliability().kind = RELIABLE_RELIABILITY_QOS;
    reading.history().depth = 10;
    reading.endpoint().history_memory_policy = PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    if (latched) reading.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
    participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(in, reading, echo);
    return true;
}

#define SERVED(package, name)                                                  \
    serve<package::msg::dds_::name##_, package::msg::dds_::name##_PubSubType>( \
        #package "::msg::dds_::" #name "_", participant, given, latched)

int main(int count, char** given) {
    if (count < 5) return 2;
    bool latched = count > 5 && std::string(given[5]) == "latched";
    auto participant = DomainParticipantFactory::get_instance()->create_participant(
        static_cast<uint32_t>(std::atoi(given[1])), PARTICIPANT_QOS_DEFAULT);
    bool known = SERVED(sensor_msgs, JointState) || SERVED(sensor_msgs, PointCloud2) ||
                 SERVED(geometry_msgs, PoseStamped) || SERVED(geometry_msgs, WrenchStamped) ||
                 SERVED(tf2_msgs, TFMessage) || SERVED(rcl_interfaces, Log) || SERVED(std_msgs, String) ||
                 SERVED(trajectory_msgs, JointTrajectory);
    if (!known) return 3;
    std::puts("ready");
    std::fflush(stdout);
    std::this_thread::sleep_for(std::chrono::seconds(120));  // Whoever has started it ends it.
}
