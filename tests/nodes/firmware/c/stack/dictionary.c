/* Access to a dictionary, as CANopenNode V4 gives it to an application. */
#include <string.h>

#include "301/CO_ODinterface.h"

OD_entry_t *OD_find(OD_t *od, uint16_t index)
{
    uint16_t each;

    for (each = 0; each < od->size; each++) {
        if (od->list[each].index == index) {
            return &od->list[each];
        }
    }
    return NULL;
}

static ODR_t find(const OD_entry_t *entry, uint8_t sub, OD_stream_t *stream)
{
    if (entry == NULL) {
        return ODR_IDX_NOT_EXIST;
    }
    memset(stream, 0, sizeof *stream);
    stream->index = entry->index;
    stream->subIndex = sub;
    stream->object = entry->extension == NULL ? NULL : entry->extension->object;
    if (entry->odObjectType == ODT_VAR && sub == 0) {
        const OD_obj_var_t *object = entry->odObject;
        stream->dataOrig = object->dataOrig;
        stream->dataLength = object->dataLength;
        stream->attribute = object->attribute;
    } else if (entry->odObjectType == ODT_ARR && sub < entry->subEntriesCount) {
        const OD_obj_array_t *object = entry->odObject;
        char *data = object->dataOrig;
        stream->dataOrig = sub == 0 ? (void *)object->dataOrig0 : data + (sub - 1u) * object->dataElementSizeof;
        stream->dataLength = sub == 0 ? 1 : object->dataElementLength;
        stream->attribute = sub == 0 ? object->attribute0 : object->attribute;
    } else if (entry->odObjectType == ODT_REC) {
        const OD_obj_record_t *object = entry->odObject, *end = object + entry->subEntriesCount;

        while (object < end && object->subIndex != sub) {
            object++;
        }
        if (object == end) {
            return ODR_SUB_NOT_EXIST;
        }
        stream->dataOrig = object->dataOrig;
        stream->dataLength = object->dataLength;
        stream->attribute = object->attribute;
    } else {
        return ODR_SUB_NOT_EXIST;
    }
    return ODR_OK;
}

void *OD_getPtr(const OD_entry_t *entry, uint8_t sub, OD_size_t len, ODR_t *err)
{
    OD_stream_t stream;

    (void)err;
    return find(entry, sub, &stream) == ODR_OK && stream.dataLength == len ? stream.dataOrig : NULL;
}

ODR_t OD_extension_init(OD_entry_t *entry, OD_extension_t *extension)
{
    if (entry == NULL) {
        return ODR_IDX_NOT_EXIST;
    }
    entry->extension = extension;
    memset(extension->flagsPDO, 0, sizeof extension->flagsPDO);
    return ODR_OK;
}

ODR_t OD_readOriginal(OD_stream_t *stream, void *buf, OD_size_t count, OD_size_t *countRead)
{
    if (stream->dataOrig == NULL || count < stream->dataLength) {
        return ODR_DEV_INCOMPAT;
    }
    memcpy(buf, stream->dataOrig, stream->dataLength);
    *countRead = stream->dataLength;
    return ODR_OK;
}

ODR_t OD_writeOriginal(OD_stream_t *stream, const void *buf, OD_size_t count, OD_size_t *countWritten)
{
    if (stream->dataOrig == NULL || count != stream->dataLength) {
        return ODR_TYPE_MISMATCH;
    }
    memcpy(stream->dataOrig, buf, count);
    *countWritten = count;
    return ODR_OK;
}

ODR_t OD_get_value(const OD_entry_t *entry, uint8_t sub, void *val, OD_size_t len, bool_t odOrig)
{
    OD_stream_t stream;
    OD_size_t done;
    ODR_t found = find(entry, sub, &stream);

    if (found != ODR_OK) {
        return found;
    }
    if (stream.dataLength != len) {
        return ODR_TYPE_MISMATCH;
    }
    return odOrig || entry->extension == NULL ? OD_readOriginal(&stream, val, len, &done)
                                              : entry->extension->read(&stream, val, len, &done);
}

ODR_t OD_set_value(const OD_entry_t *entry, uint8_t sub, void *val, OD_size_t len, bool_t odOrig)
{
    OD_stream_t stream;
    OD_size_t done;
    ODR_t found = find(entry, sub, &stream);

    if (found != ODR_OK) {
        return found;
    }
    if (odOrig || entry->extension == NULL) {
        return OD_writeOriginal(&stream, val, len, &done);
    }
    return entry->extension->write == NULL ? ODR_READONLY : entry->extension->write(&stream, val, len, &done);
}
