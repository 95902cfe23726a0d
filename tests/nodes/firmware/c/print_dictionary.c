/* Prints every object of OD.c: index, sub-index, attribute, value in hexadecimal as it travels in an SDO; then the signature
 * (2006h). Arguments are the number of the bus and the node-ID of a board of the image.
 */
#include <stdio.h>
#include <stdlib.h>

#include "301/CO_ODinterface.h"
#include "OD.h"
#include "skin_canopennode.h"

static void print(const OD_entry_t *entry, unsigned subindex, unsigned attribute, const void *data, unsigned length)
{
    unsigned place;

    printf("%04X %u %02X ", entry->index, subindex, attribute);
    for (place = 0; place < length; place++) {
        if (data == NULL) {
            printf("--");
        } else {
            printf("%02x", ((const uint8_t *)data)[place]);
        }
    }
    printf("\n");
}

int main(int count, char **texts)
{
    uint32_t signature = 0;
    uint16_t each;
    unsigned sub;

    if (count == 3 && skin_app_choose((uint8_t)atoi(texts[1]), (uint8_t)atoi(texts[2])) != 0) {
        return 1;
    }
    for (each = 0; each < OD->size; each++) {
        const OD_entry_t *entry = &OD->list[each];

        if (entry->odObjectType == ODT_VAR) {
            const OD_obj_var_t *object = entry->odObject;
            print(entry, 0, object->attribute, object->dataOrig, object->dataLength);
        } else if (entry->odObjectType == ODT_ARR) {
            const OD_obj_array_t *object = entry->odObject;
            print(entry, 0, object->attribute0, object->dataOrig0, 1);
            for (sub = 1; sub < entry->subEntriesCount; sub++) {
                const char *data = object->dataOrig;
                print(entry, sub, object->attribute, data == NULL ? NULL : data + (sub - 1) * object->dataElementSizeof,
                      object->dataElementLength);
            }
        } else {
            const OD_obj_record_t *object = entry->odObject;
            for (sub = 0; sub < entry->subEntriesCount; sub++) {
                print(entry, object[sub].subIndex, object[sub].attribute, object[sub].dataOrig, object[sub].dataLength);
            }
        }
    }
    if (skin_app_init() != 0 || OD_get_value(OD_find(OD, 0x2006), 0, &signature, sizeof signature, false) != ODR_OK) {
        return 1;
    }
    printf("%lu\n", (unsigned long)signature);
    return 0;
}
