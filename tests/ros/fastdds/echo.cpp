// Says on one topic what it hears on another: a program of another vendor, as Fast DDS makes it.
#include <chrono>
#include <cstdio>
#include <cstdlib>
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

#include "JointStatePubSubTypes.h"

using namespace eprosima::fastdds::dds;
using Message = sensor_msgs::msg::dds_::JointState_;

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

int main(int count, char** given) {
    if (count != 4) return 2;
    auto participant = DomainParticipantFactory::get_instance()->create_participant(
        static_cast<uint32_t>(std::atoi(given[1])), PARTICIPANT_QOS_DEFAULT);
    TypeSupport type(new sensor_msgs::msg::dds_::JointState_PubSubType());
    type->setName("sensor_msgs::msg::dds_::JointState_");
    type.register_type(participant);
    auto in = participant->create_topic(given[2], type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto out = participant->create_topic(given[3], type.get_type_name(), TOPIC_QOS_DEFAULT);

    DataWriterQos writing = DATAWRITER_QOS_DEFAULT;
    writing.reliability().kind = RELIABLE_RELIABILITY_QOS;
    writing.history().depth = 10;
    Echo echo;
    echo.writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(out, writing);
    DataReaderQos reading = DATAREADER_QOS_DEFAULT;
    reading.reliability().kind = RELIABLE_RELIABILITY_QOS;
    reading.history().depth = 10;
    participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(in, reading, &echo);
    std::puts("ready");
    std::fflush(stdout);
    std::this_thread::sleep_for(std::chrono::seconds(120));  // Whoever has started it ends it.
}
